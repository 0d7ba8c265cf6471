"""The step of the Strömbom flock, compiled for the CPU."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math
from typing import Any

import numpy as np
from shepherd_ros.sim.compiled import compiled, flat_array
from shepherd_ros.sim.neighbor_grid import around, build, leaves_out, nothing, within
from shepherd_ros.sim.neighbors_compiled import (
    bound_of,
    break_tie,
    choose_below,
    in_reach,
    squares,
    squares_of,
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
_LARGE = 850  # flocks from this size on are put on a grid, if that leaves many out


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
def _relative(sheep, mask, xs, ys, near_x, near_y, who, who_x, who_y):
    """
    Write places (N,) m, also relative to one sheep; return how many others a sheep has, and sums.

    Means of far places would be rounded by more than sheep differ.
    """
    others, sum_x, sum_y = -1, _ZERO, _ZERO
    for j in range(sheep.shape[0]):
        xs[j], ys[j] = sheep[j, 0], sheep[j, 1]
        near_x[j], near_y[j] = xs[j] - xs[0], ys[j] - ys[0]
        who[j], who_x[j], who_y[j] = j, near_x[j], near_y[j]  # unless there is a grid
        if mask[j]:
            others += 1
            sum_x += near_x[j]
            sum_y += near_y[j]
    return others, sum_x, sum_y


@compiled
def _around(i, keep, xs, ys, grid, who, squared, who_x, who_y):
    """Write the places of around() into who_x, who_y (N,) m, as _relative(); return how many."""
    found = around(i, xs, ys, keep, grid, who, squared)
    for k in range(found):
        who_x[k], who_y[k] = xs[who[k]] - xs[0], ys[who[k]] - ys[0]
    return found


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
    way_x, way_y, to_x, to_y, apart_x, apart_y, away_x, away_y, turn, i, rho_a, c, rho_s, h, e,
    normalize,
):  # fmt: skip
    """Return the heading after the terms of the flock, the one before where they cancel."""
    random_x, random_y = direction_at(turn, i)
    apart_x, apart_y = unit_xy(apart_x, apart_y)
    if normalize:
        away_x, away_y = unit_xy(away_x, away_y)
    new_x, new_y = unit_xy(
        h * way_x + c * to_x + rho_a * apart_x + rho_s * away_x + e * random_x,
        h * way_y + c * to_y + rho_a * apart_y + rho_s * away_y + e * random_y,
    )
    if new_x != 0 or new_y != 0:
        return new_x, new_y
    return way_x, way_y


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
    xs, ys, near_x, near_y, squared, values, who_x, who_y, part_x, part_y = _floats(n)
    chosen, who = np.empty(n, np.int64), np.empty(n, np.int64)
    noticed, reach = np.empty(shepherds.shape[1], np.int64), sheep_range * sheep_range
    for b in range(sheep.shape[0]):
        turn, graze = stream_key(seed[b], step[b], _TURN), stream_key(seed[b], step[b], _GRAZE)
        here, team = mask[b], shepherd_mask[b]
        others, sum_x, sum_y = _relative(sheep[b], here, xs, ys, near_x, near_y, who, who_x, who_y)
        count, found, beyond = min(others, n_neighbors), n, _ONE
        grid = build(sheep[b], mask[b]) if n >= _LARGE else nothing()
        large = leaves_out(sheep_range, grid)
        for i in range(n):
            x, y, way_x, way_y = xs[i], ys[i], heading[b, i, 0], heading[b, i, 1]
            met = in_reach(x, y, shepherds[b], team, shepherd_range, noticed)
            moving = met > 0 or uniform_at(graze, i) < p
            if met > 0:
                away_x, away_y = _push(x, y, shepherds[b], noticed, met)
                if large:
                    found = within(i, sheep_range, grid, who)
                    squares_of(i, xs, ys, who, found, squared)
                else:
                    squares(i, xs, ys, here, squared)
                met = choose_below(reach, found, squared, who, chosen)
                apart_x, apart_y = _push(x, y, sheep[b], chosen, met)
                to_x, to_y = sum_x - near_x[i], sum_y - near_y[i]
                if 0 < count < others:
                    # the farthest of them are about as far beyond the middle for all sheep
                    off = _from_middle(near_x[i], near_y[i], sum_x, sum_y, others + 1)
                    guess = (off + beyond) * (off + beyond)
                    if large:
                        found = _around(i, count, xs, ys, grid, who, squared, who_x, who_y)
                    bound = bound_of(count, found, squared, guess, values)
                    break_tie(count, found, squared, bound, who)
                    to_x, to_y = _sum_within(bound, found, squared, who_x, who_y, part_x, part_y)
                    beyond = np.float32(math.sqrt(bound)) - off
                to_x, to_y = _cohesion(to_x, to_y, count, near_x[i], near_y[i], metric)
                way_x, way_y = _turned(
                    way_x, way_y, to_x, to_y, apart_x, apart_y, away_x, away_y, turn, i, rho_a, c,
                    rho_s, h, e, normalize,
                )  # fmt: skip
            elif moving:
                way_x, way_y = direction_at(turn, i)
            new_heading[b, i, 0], new_heading[b, i, 1] = way_x, way_y
            if moving:
                x, y = x + stride * way_x, y + stride * way_y
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
