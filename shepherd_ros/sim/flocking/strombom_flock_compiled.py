"""The step of the Strömbom flock, compiled for the CPU."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math
from typing import Any

import numpy as np
from shepherd_ros.sim.compiled import compiled, flat_array
from shepherd_ros.sim.neighbor_grid import (
    build_grid,
    candidates_within,
    empty_grid,
    nearest_candidates,
    reduces_candidates,
)
from shepherd_ros.sim.neighbors_compiled import (
    break_tie,
    in_reach,
    kth_bound,
    select_below,
    squared_distances,
    squared_distances_of,
)
from shepherd_ros.sim.rng import Stream
from shepherd_ros.sim.rng_compiled import direction_at, stream_key, uniform_at
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import EPSILON
from shepherd_ros.sim.vectors_compiled import length, unit_xy
import torch
from torch import Tensor

_TURN, _GRAZE = int(Stream.TURN), int(Stream.GRAZE)
_EPSILON = np.float32(EPSILON)
_ZERO, _ONE = np.float32(0), np.float32(1)
_GRID_MIN_SHEEP = 850  # flocks from this size on use a grid, if it leaves out many sheep


@compiled
def _push(x, y, others, chosen, count):
    """Return the sum of unit offsets from the chosen of the others (K, 2) m."""
    push_x, push_y = _ZERO, _ZERO
    for k in range(count):
        j = chosen[k]
        dx, dy = x - others[j, 0], y - others[j, 1]
        squared = dx * dx + dy * dy
        if squared > _EPSILON * _EPSILON:
            inverse = _ONE / np.float32(math.sqrt(squared))
            push_x += dx * inverse
            push_y += dy * inverse
    return push_x, push_y


@compiled
def _sum_within(bound, count, squared, xs, ys, part_x, part_y):
    """
    Return the sum of those of the first count of xs, ys (N,) whose squared distance is below it.

    The others are made zero first, many at once; then all are added one after another, so that
    the sum is the same on every processor.
    """
    for k in range(count):
        near = squared[k] < bound
        part_x[k], part_y[k] = xs[k] if near else _ZERO, ys[k] if near else _ZERO
    sum_x, sum_y = _ZERO, _ZERO
    for k in range(count):
        sum_x += part_x[k]
        sum_y += part_y[k]
    return sum_x, sum_y


@compiled
def _relative(sheep, mask, xs, ys, near_x, near_y, pool, px, py):
    """
    Write places (N,) m, also relative to one sheep; return the number of others, and sums.

    Means of far places would be rounded by more than sheep differ.
    """
    others, sum_x, sum_y = -1, _ZERO, _ZERO
    for j in range(sheep.shape[0]):
        xs[j], ys[j] = sheep[j, 0], sheep[j, 1]
        near_x[j], near_y[j] = xs[j] - xs[0], ys[j] - ys[0]
        pool[j], px[j], py[j] = j, near_x[j], near_y[j]  # unless there is a grid
        if mask[j]:
            others += 1
            sum_x += near_x[j]
            sum_y += near_y[j]
    return others, sum_x, sum_y


@compiled
def _around(i, keep, xs, ys, grid, pool, squared, px, py):
    """Write nearest_candidates() and their places (N,) m, as _relative(); return their number."""
    pool_size = nearest_candidates(i, xs, ys, keep, grid, pool, squared)
    for k in range(pool_size):
        px[k], py[k] = xs[pool[k]] - xs[0], ys[pool[k]] - ys[0]
    return pool_size


@compiled
def _from_middle(x, y, sum_x, sum_y, count):
    """Return the distance of x, y from the middle of count sheep [m]."""
    return length(x - sum_x / np.float32(count), y - sum_y / np.float32(count))


@compiled
def _cohesion(sum_x, sum_y, count, x, y, metric):
    """Return the pull of a sheep at x, y to the mean of count others."""
    to_x, to_y = _ZERO, _ZERO
    if count > 0:
        to_x, to_y = sum_x / np.float32(count) - x, sum_y / np.float32(count) - y
    if not metric:
        to_x, to_y = unit_xy(to_x, to_y)
    return to_x, to_y


@compiled
def _turned(
    last_x, last_y, to_x, to_y, apart_x, apart_y, away_x, away_y, turn, i, rho_a, c, rho_s, h, e,
    normalize,
):  # fmt: skip
    """Return the heading after the terms of the flock, the one before where they cancel."""
    random_x, random_y = direction_at(turn, i)
    apart_x, apart_y = unit_xy(apart_x, apart_y)
    if normalize:
        away_x, away_y = unit_xy(away_x, away_y)
    new_x, new_y = unit_xy(
        h * last_x + c * to_x + rho_a * apart_x + rho_s * away_x + e * random_x,
        h * last_y + c * to_y + rho_a * apart_y + rho_s * away_y + e * random_y,
    )
    if new_x != 0 or new_y != 0:
        return new_x, new_y
    return last_x, last_y


@compiled
def _floats(n):
    """Return ten arrays (N,) to work in."""
    a, b, c = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    d, e, f = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    g, h, k = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    return a, b, c, d, e, f, g, h, k, np.empty(n, np.float32)


@compiled
def _strombom(
    seed, step, sheep, heading, mask, shepherds, shepherd_mask, n_neighbors, shepherd_range,
    sheep_range, rho_a, c, rho_s, h, e, p, stride, normalize, metric, new_sheep, new_heading,
):  # fmt: skip
    n = sheep.shape[1]
    xs, ys, near_x, near_y, squared, values, px, py, part_x, part_y = _floats(n)
    chosen, pool = np.empty(n, np.int64), np.empty(n, np.int64)
    noticed, reach = np.empty(shepherds.shape[1], np.int64), sheep_range * sheep_range
    for b in range(sheep.shape[0]):
        turn, graze = stream_key(seed[b], step[b], _TURN), stream_key(seed[b], step[b], _GRAZE)
        real, team = mask[b], shepherd_mask[b]
        others, sum_x, sum_y = _relative(sheep[b], real, xs, ys, near_x, near_y, pool, px, py)
        count, size, beyond = min(others, n_neighbors), n, _ONE
        grid = build_grid(sheep[b], mask[b]) if n >= _GRID_MIN_SHEEP else empty_grid()
        large = reduces_candidates(sheep_range, grid)
        for i in range(n):
            x, y, heading_x, heading_y = xs[i], ys[i], heading[b, i, 0], heading[b, i, 1]
            n_near = in_reach(x, y, shepherds[b], team, shepherd_range, noticed)
            moving = n_near > 0 or uniform_at(graze, i) < p
            if n_near > 0:
                away_x, away_y = _push(x, y, shepherds[b], noticed, n_near)
                if large:
                    size = candidates_within(i, sheep_range, grid, pool)
                    squared_distances_of(i, xs, ys, pool, size, squared)
                else:
                    squared_distances(i, xs, ys, real, squared)
                n_near = select_below(reach, size, squared, pool, chosen)
                apart_x, apart_y = _push(x, y, sheep[b], chosen, n_near)
                to_x, to_y = sum_x - near_x[i], sum_y - near_y[i]
                if 0 < count < others:
                    # the farthest of them are about as far beyond the middle for all sheep
                    offset = _from_middle(near_x[i], near_y[i], sum_x, sum_y, others + 1)
                    guess = (offset + beyond) * (offset + beyond)
                    if large:
                        size = _around(i, count, xs, ys, grid, pool, squared, px, py)
                    bound = kth_bound(count, size, squared, guess, values)
                    break_tie(count, size, squared, bound, pool)
                    to_x, to_y = _sum_within(bound, size, squared, px, py, part_x, part_y)
                    beyond = np.float32(math.sqrt(bound)) - offset
                to_x, to_y = _cohesion(to_x, to_y, count, near_x[i], near_y[i], metric)
                heading_x, heading_y = _turned(
                    heading_x, heading_y, to_x, to_y, apart_x, apart_y, away_x, away_y, turn, i,
                    rho_a, c, rho_s, h, e, normalize,
                )  # fmt: skip
            elif moving:
                heading_x, heading_y = direction_at(turn, i)
            new_heading[b, i, 0], new_heading[b, i, 1] = heading_x, heading_y
            if moving:
                x, y = x + stride * heading_x, y + stride * heading_y
            new_sheep[b, i, 0], new_sheep[b, i, 1] = x, y


def strombom_step(state: WorldState, config: Any, dt: float) -> tuple[Tensor, Tensor]:
    """Return the result of sim.flocking.strombom_flock.strombom_flock_step()."""
    sheep = flat_array(state.sheep, 2)
    new_sheep, new_heading = np.empty_like(sheep), np.empty_like(sheep)
    weights = (
        config.shepherd_range,
        config.sheep_range,
        config.sheep_repulsion,
        config.cohesion,
        config.shepherd_repulsion,
        config.inertia,
        config.noise,
        config.graze_probability,
        config.speed * dt,
    )
    _strombom(
        flat_array(state.seed, 0),
        flat_array(state.step, 0),
        sheep,
        flat_array(state.heading, 2),
        flat_array(state.sheep_mask, 1),
        flat_array(state.shepherds, 2),
        flat_array(state.shepherd_mask, 1),
        config.n_neighbors,
        *(np.float32(weight) for weight in weights),
        config.normalize_shepherds,
        config.metric_attraction,
        new_sheep,
        new_heading,
    )
    shape = state.sheep.shape
    return torch.from_numpy(new_sheep).reshape(shape), torch.from_numpy(new_heading).reshape(shape)
