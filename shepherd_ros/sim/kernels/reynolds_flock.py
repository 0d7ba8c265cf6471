"""The step of the Reynolds flock, compiled for the CPU."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from typing import Any

import numpy as np
from shepherd_ros.sim.kernels import compiled, flat
from shepherd_ros.sim.kernels.grid import build, nothing, within
from shepherd_ros.sim.kernels.vectors import length, unit
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import EPSILON
import torch
from torch import Tensor

_EPSILON = np.float32(EPSILON)
_ZERO, _ONE = np.float32(0), np.float32(1)
_LARGE = 600  # flocks from this size on are put on a grid
_TINY = np.float32(0.01)  # of a term: sim.flocking.reynolds.TINY


@compiled
def _fear(x, y, others, mask, view, nearest, me):
    """Return the sum of offsets over squared distance from the others in view, me left out."""
    sum_x, sum_y = _ZERO, _ZERO
    for k in range(others.shape[0]):
        dx, dy = x - others[k, 0], y - others[k, 1]
        squared = dx * dx + dy * dy
        if squared < view * view and mask[k] and k != me:
            inverse = _ONE / max(squared, nearest * nearest)
            sum_x += dx * inverse
            sum_y += dy * inverse
    return sum_x, sum_y


@compiled
def _seen(i, sheep, heading, mask, view):
    """Return how many sheep sheep i sees, and the sums of offsets to them and of headings."""
    count = 0
    sum_x, sum_y, turn_x, turn_y = _ZERO, _ZERO, _ZERO, _ZERO
    for j in range(sheep.shape[0]):
        dx, dy = sheep[i, 0] - sheep[j, 0], sheep[i, 1] - sheep[j, 1]
        if j != i and mask[j] and dx * dx + dy * dy < view * view:
            count += 1
            sum_x -= dx
            sum_y -= dy
            turn_x += heading[j, 0]
            turn_y += heading[j, 1]
    return count, sum_x, sum_y, turn_x, turn_y


@compiled
def _seen_by(i, sheep, heading, candidates, many, view):
    """Return _seen() of those sheep that are candidates."""
    count = 0
    sum_x, sum_y, turn_x, turn_y = _ZERO, _ZERO, _ZERO, _ZERO
    for m in range(many):
        j = candidates[m]
        dx, dy = sheep[i, 0] - sheep[j, 0], sheep[i, 1] - sheep[j, 1]
        if j != i and dx * dx + dy * dy < view * view:
            count += 1
            sum_x -= dx
            sum_y -= dy
            turn_x += heading[j, 0]
            turn_y += heading[j, 1]
    return count, sum_x, sum_y, turn_x, turn_y


@compiled
def _fear_by(x, y, others, candidates, count, view, nearest, me):
    """Return _fear() of those of the others that are candidates."""
    sum_x, sum_y = _ZERO, _ZERO
    for m in range(count):
        k = candidates[m]
        dx, dy = x - others[k, 0], y - others[k, 1]
        squared = dx * dx + dy * dy
        if squared < view * view and k != me:
            inverse = _ONE / max(squared, nearest * nearest)
            sum_x += dx * inverse
            sum_y += dy * inverse
    return sum_x, sum_y


@compiled
def _direction(x, y):
    """Return a term made one long; a tiny one stays short."""
    size = max(length(x, y), _TINY)
    return x / size, y / size


@compiled
def _reynolds(
    sheep, heading, mask, shepherds, shepherd_mask, directions, view, w_s, w_v, w_c, w_f, limit,
    nearest, speed, dt, new_sheep, new_heading,
):  # fmt: skip
    n = sheep.shape[1]
    large = n >= _LARGE
    candidates = np.empty(n, np.int64)
    for b in range(sheep.shape[0]):
        grid = build(sheep[b], mask[b]) if large else nothing()
        met = 0
        for i in range(n):
            x, y = sheep[b, i, 0], sheep[b, i, 1]
            if large:
                met = within(i, view, grid, candidates)
                count, sum_x, sum_y, turn_x, turn_y = _seen_by(
                    i, sheep[b], heading[b], candidates, met, view
                )
            else:
                count, sum_x, sum_y, turn_x, turn_y = _seen(i, sheep[b], heading[b], mask[b], view)
            u, v = heading[b, i, 0] * speed, heading[b, i, 1] * speed
            force_x, force_y = _ZERO, _ZERO
            if count > 0:
                others = np.float32(count)
                if large:
                    apart_x, apart_y = _fear_by(x, y, sheep[b], candidates, met, view, nearest, i)
                else:
                    apart_x, apart_y = _fear(x, y, sheep[b], mask[b], view, nearest, i)
                to_x, to_y = sum_x / others, sum_y / others
                along_x, along_y = turn_x / others * speed - u, turn_y / others * speed - v
                if directions:
                    apart_x, apart_y = _direction(apart_x, apart_y)
                    to_x, to_y = _direction(to_x, to_y)
                    mean_x, mean_y = _direction(turn_x / others, turn_y / others)
                    own_x, own_y = _direction(heading[b, i, 0], heading[b, i, 1])
                    along_x, along_y = mean_x - own_x, mean_y - own_y
                force_x = w_s * apart_x + w_v * along_x + w_c * to_x
                force_y = w_s * apart_y + w_v * along_y + w_c * to_y
            away_x, away_y = _fear(x, y, shepherds[b], shepherd_mask[b], view, nearest, -1)
            if directions:
                away_x, away_y = _direction(away_x, away_y)
            force_x, force_y = force_x + w_f * away_x, force_y + w_f * away_y
            size = length(force_x, force_y)
            if size > limit:
                scale = limit / max(size, _EPSILON)
                force_x, force_y = force_x * scale, force_y * scale
            way_x, way_y = unit(u + force_x * dt, v + force_y * dt)
            if way_x == 0 and way_y == 0:
                way_x, way_y = heading[b, i, 0], heading[b, i, 1]
            new_heading[b, i, 0], new_heading[b, i, 1] = way_x, way_y
            new_sheep[b, i, 0] = x + speed * dt * way_x
            new_sheep[b, i, 1] = y + speed * dt * way_y


def reynolds_step(state: WorldState, config: Any, dt: float) -> tuple[Tensor, Tensor]:
    """Return what sim.flocking.reynolds.step() does."""
    sheep = flat(state.sheep, 2)
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
        flat(state.heading, 2),
        flat(state.sheep_mask, 1),
        flat(state.shepherds, 2),
        flat(state.shepherd_mask, 1),
        config.terms == 'unit',
        *(np.float32(weight) for weight in weights),
        new_sheep,
        new_heading,
    )
    shape = state.sheep.shape
    return torch.from_numpy(new_sheep).reshape(shape), torch.from_numpy(new_heading).reshape(shape)
