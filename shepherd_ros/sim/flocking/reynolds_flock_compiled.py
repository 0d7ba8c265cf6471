"""The step of the Reynolds flock, compiled for the CPU."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from typing import Any

import numpy as np
from shepherd_ros.sim.compiled import compiled, flat_array
from shepherd_ros.sim.neighbor_grid import (
    build_grid,
    candidates_within,
    empty_grid,
    reduces_candidates,
)
from shepherd_ros.sim.neighbors_compiled import (
    in_reach,
    select_below,
    squared_distances,
    squared_distances_of,
)
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import EPSILON
from shepherd_ros.sim.vectors_compiled import length, unit_xy
import torch
from torch import Tensor

_EPSILON = np.float32(EPSILON)
_ZERO, _ONE = np.float32(0), np.float32(1)
_GRID_MIN_SHEEP = 600  # flocks from this size on use a grid, if it leaves out many sheep
_SOFT_LENGTH = np.float32(0.01)  # that of sim.flocking.reynolds_flock


@compiled
def _fear(x, y, others, chosen, count, nearest):
    """Return the sum of offsets over squared distance from the chosen of the others (K, 2) m."""
    sum_x, sum_y = _ZERO, _ZERO
    for m in range(count):
        k = chosen[m]
        dx, dy = x - others[k, 0], y - others[k, 1]
        inverse = _ONE / max(dx * dx + dy * dy, nearest * nearest)
        sum_x += dx * inverse
        sum_y += dy * inverse
    return sum_x, sum_y


@compiled
def _flockmates(x, y, sheep, heading, chosen, count, nearest):
    """Return the sums over the chosen sheep of offsets to them, of headings, and _fear()."""
    sum_x, sum_y, turn_x, turn_y, away_x, away_y = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    for m in range(count):
        j = chosen[m]
        dx, dy = x - sheep[j, 0], y - sheep[j, 1]
        inverse = _ONE / max(dx * dx + dy * dy, nearest * nearest)
        sum_x -= dx
        sum_y -= dy
        turn_x += heading[j, 0]
        turn_y += heading[j, 1]
        away_x += dx * inverse
        away_y += dy * inverse
    return sum_x, sum_y, turn_x, turn_y, away_x, away_y


@compiled
def _direction(x, y):
    """Return a term as a unit vector; below _SOFT_LENGTH in proportion."""
    size = max(length(x, y), _SOFT_LENGTH)
    return x / size, y / size


@compiled
def _difference(x, y, from_x, from_y):
    """Return the difference of two directions."""
    to_x, to_y = _direction(x, y)
    from_x, from_y = _direction(from_x, from_y)
    return to_x - from_x, to_y - from_y


@compiled
def _limited(x, y, max_norm):
    """Return a vector cut to max_norm, its direction kept."""
    size = length(x, y)
    if size > max_norm:
        scale = max_norm / max(size, _EPSILON)
        x, y = x * scale, y * scale
    return x, y


@compiled
def _reynolds(
    sheep, heading, mask, shepherds, shepherd_mask, directions, view, w_s, w_v, w_c, w_f, limit,
    nearest, speed, dt, new_sheep, new_heading,
):  # fmt: skip
    n = sheep.shape[1]
    xs, ys, squared = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    chosen, candidates, indices = np.empty(n, np.int64), np.empty(n, np.int64), np.arange(n)
    noticed = np.empty(shepherds.shape[1], np.int64)
    for b in range(sheep.shape[0]):
        for j in range(n):
            xs[j], ys[j] = sheep[b, j, 0], sheep[b, j, 1]
        grid = build_grid(sheep[b], mask[b]) if n >= _GRID_MIN_SHEEP else empty_grid()
        large = reduces_candidates(view, grid)
        for i in range(n):
            x, y = xs[i], ys[i]
            if large:
                n_candidates = candidates_within(i, view, grid, candidates)
                squared_distances_of(i, xs, ys, candidates, n_candidates, squared)
                count = select_below(view * view, n_candidates, squared, candidates, chosen)
            else:
                squared_distances(i, xs, ys, mask[b], squared)
                count = select_below(view * view, n, squared, indices, chosen)
            u, v = heading[b, i, 0] * speed, heading[b, i, 1] * speed
            force_x, force_y = _ZERO, _ZERO
            if count > 0:
                others = np.float32(count)
                sum_x, sum_y, turn_x, turn_y, apart_x, apart_y = _flockmates(
                    x, y, sheep[b], heading[b], chosen, count, nearest
                )
                to_x, to_y = sum_x / others, sum_y / others
                along_x, along_y = turn_x / others * speed - u, turn_y / others * speed - v
                if directions:
                    apart_x, apart_y = _direction(apart_x, apart_y)
                    to_x, to_y = _direction(to_x, to_y)
                    along_x, along_y = _difference(
                        turn_x / others, turn_y / others, heading[b, i, 0], heading[b, i, 1]
                    )
                force_x = w_s * apart_x + w_v * along_x + w_c * to_x
                force_y = w_s * apart_y + w_v * along_y + w_c * to_y
            n_noticed = in_reach(x, y, shepherds[b], shepherd_mask[b], view, noticed)
            away_x, away_y = _fear(x, y, shepherds[b], noticed, n_noticed, nearest)
            if directions:
                away_x, away_y = _direction(away_x, away_y)
            force_x, force_y = _limited(force_x + w_f * away_x, force_y + w_f * away_y, limit)
            turned_x, turned_y = unit_xy(u + force_x * dt, v + force_y * dt)
            if turned_x == 0 and turned_y == 0:
                turned_x, turned_y = heading[b, i, 0], heading[b, i, 1]
            new_heading[b, i, 0], new_heading[b, i, 1] = turned_x, turned_y
            new_sheep[b, i, 0] = x + speed * dt * turned_x
            new_sheep[b, i, 1] = y + speed * dt * turned_y


def reynolds_step(state: WorldState, config: Any, dt: float) -> tuple[Tensor, Tensor]:
    """Return the result of sim.flocking.reynolds_flock.reynolds_flock_step()."""
    sheep = flat_array(state.sheep, 2)
    new_sheep, new_heading = np.empty_like(sheep), np.empty_like(sheep)
    weights = (
        config.view_range,
        config.separation,
        config.alignment,
        config.cohesion,
        config.fear,
        config.max_acceleration,
        config.min_distance,
        config.speed,
        dt,
    )
    _reynolds(
        sheep,
        flat_array(state.heading, 2),
        flat_array(state.sheep_mask, 1),
        flat_array(state.shepherds, 2),
        flat_array(state.shepherd_mask, 1),
        config.terms == 'unit',
        *(np.float32(weight) for weight in weights),
        new_sheep,
        new_heading,
    )
    shape = state.sheep.shape
    return torch.from_numpy(new_sheep).reshape(shape), torch.from_numpy(new_heading).reshape(shape)
