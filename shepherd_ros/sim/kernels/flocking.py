"""The flock models of sim.flocking, sheep by sheep."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math
from typing import Any

import numpy as np
from shepherd_ros.sim.kernels import compiled, flat
from shepherd_ros.sim.kernels.noise import direction_at, key_of, uniform_at
from shepherd_ros.sim.noise import Stream
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import EPSILON
import torch
from torch import Tensor

_TURN, _GRAZE = int(Stream.TURN), int(Stream.GRAZE)
_EPSILON = np.float32(EPSILON)
_ZERO, _ONE = np.float32(0), np.float32(1)


@compiled
def _unit(x, y):
    length = np.float32(math.sqrt(x * x + y * y))
    if length < _EPSILON:
        return _ZERO, _ZERO
    return x / length, y / length


@compiled
def _push(x, y, others, mask, reach):
    """Return the sum of unit offsets from the others within reach, and whether there are any."""
    push_x, push_y, noticed = _ZERO, _ZERO, False
    for k in range(others.shape[0]):
        dx, dy = x - others[k, 0], y - others[k, 1]
        squared = dx * dx + dy * dy
        if squared < reach * reach and mask[k]:
            noticed = True
            if squared > _EPSILON * _EPSILON:
                inverse = _ONE / np.float32(math.sqrt(squared))
                push_x += dx * inverse
                push_y += dy * inverse
    return push_x, push_y, noticed


@compiled
def _sum_of_extremes(i, sheep, mask, squared, keep, sign, best, index):
    """Return the sum of the keep sheep nearest to sheep i (sign 1) or farthest (sign -1)."""
    found = 0
    for j in range(sheep.shape[0]):
        key = sign * squared[j]
        if j == i or not mask[j] or (found == keep and key >= best[found - 1]):
            continue
        k = found if found < keep else found - 1
        while k > 0 and best[k - 1] > key:
            best[k], index[k] = best[k - 1], index[k - 1]
            k -= 1
        best[k], index[k] = key, j
        found = min(found + 1, keep)
    sum_x, sum_y = _ZERO, _ZERO
    for k in range(found):
        sum_x += sheep[index[k], 0]
        sum_y += sheep[index[k], 1]
    return sum_x, sum_y


@compiled
def _strombom(
    seed, step, sheep, heading, mask, shepherds, shepherd_mask, n_neighbors, shepherd_range,
    sheep_range, rho_a, c, rho_s, h, e, p, stride, normalize, metric, new_sheep, new_heading,
):  # fmt: skip
    n = sheep.shape[1]
    squared, best = np.empty(n, np.float32), np.empty(n, np.float32)
    index = np.empty(n, np.int64)
    for b in range(sheep.shape[0]):
        turn, graze = key_of(seed[b], step[b], _TURN), key_of(seed[b], step[b], _GRAZE)
        others = -1
        sum_x, sum_y = _ZERO, _ZERO
        # relative to one sheep: means of far places would be rounded by more than sheep differ
        near = sheep[b] - sheep[b, 0]
        for j in range(n):
            if mask[b, j]:
                others += 1
                sum_x += near[j, 0]
                sum_y += near[j, 1]
        far = others - n_neighbors
        count = min(others, n_neighbors)
        for i in range(n):
            x, y = sheep[b, i, 0], sheep[b, i, 1]
            random_x, random_y = direction_at(turn, i)
            way_x, way_y = heading[b, i, 0], heading[b, i, 1]
            away_x, away_y, reacting = _push(x, y, shepherds[b], shepherd_mask[b], shepherd_range)
            moving = True
            if reacting:
                to_x, to_y = _ZERO, _ZERO
                if count > 0:
                    to_x, to_y = sum_x - near[i, 0], sum_y - near[i, 1]
                    if far > 0:
                        for j in range(n):
                            dx, dy = x - sheep[b, j, 0], y - sheep[b, j, 1]
                            squared[j] = dx * dx + dy * dy
                        if far <= n_neighbors:
                            far_x, far_y = _sum_of_extremes(
                                i, near, mask[b], squared, far, np.float32(-1), best, index
                            )
                            to_x, to_y = to_x - far_x, to_y - far_y
                        else:
                            to_x, to_y = _sum_of_extremes(
                                i, near, mask[b], squared, count, _ONE, best, index
                            )
                    to_x = to_x / np.float32(count) - near[i, 0]
                    to_y = to_y / np.float32(count) - near[i, 1]
                if not metric:
                    to_x, to_y = _unit(to_x, to_y)
                apart_x, apart_y, _ = _push(x, y, sheep[b], mask[b], sheep_range)
                apart_x, apart_y = _unit(apart_x, apart_y)
                if normalize:
                    away_x, away_y = _unit(away_x, away_y)
                new_x, new_y = _unit(
                    h * way_x + c * to_x + rho_a * apart_x + rho_s * away_x + e * random_x,
                    h * way_y + c * to_y + rho_a * apart_y + rho_s * away_y + e * random_y,
                )
                if new_x != 0 or new_y != 0:
                    way_x, way_y = new_x, new_y
            elif uniform_at(graze, i) < p:
                way_x, way_y = random_x, random_y
            else:
                moving = False
            new_heading[b, i, 0], new_heading[b, i, 1] = way_x, way_y
            new_sheep[b, i, 0], new_sheep[b, i, 1] = x, y
            if moving:
                new_sheep[b, i, 0] = x + stride * way_x
                new_sheep[b, i, 1] = y + stride * way_y


def strombom_step(state: WorldState, config: Any, dt: float) -> tuple[Tensor, Tensor]:
    """Return what sim.flocking.strombom.step() does."""
    sheep = flat(state.sheep, 2)
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
        flat(state.seed, 0),
        flat(state.step, 0),
        sheep,
        flat(state.heading, 2),
        flat(state.sheep_mask, 1),
        flat(state.shepherds, 2),
        flat(state.shepherd_mask, 1),
        config.n_neighbors,
        *(np.float32(weight) for weight in weights),
        config.normalize_shepherds,
        config.metric_attraction,
        new_sheep,
        new_heading,
    )
    shape = state.sheep.shape
    return torch.from_numpy(new_sheep).reshape(shape), torch.from_numpy(new_heading).reshape(shape)


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
def _reynolds(
    sheep, heading, mask, shepherds, shepherd_mask, view, w_s, w_v, w_c, w_f, limit, nearest,
    speed, dt, new_sheep, new_heading,
):  # fmt: skip
    n = sheep.shape[1]
    for b in range(sheep.shape[0]):
        for i in range(n):
            x, y = sheep[b, i, 0], sheep[b, i, 1]
            count = 0
            sum_x, sum_y, sum_u, sum_v = _ZERO, _ZERO, _ZERO, _ZERO
            for j in range(n):
                dx, dy = x - sheep[b, j, 0], y - sheep[b, j, 1]
                if j != i and mask[b, j] and dx * dx + dy * dy < view * view:
                    count += 1
                    sum_x += sheep[b, j, 0]
                    sum_y += sheep[b, j, 1]
                    sum_u += heading[b, j, 0] * speed
                    sum_v += heading[b, j, 1] * speed
            u, v = heading[b, i, 0] * speed, heading[b, i, 1] * speed
            force_x, force_y = _ZERO, _ZERO
            if count > 0:
                others = np.float32(count)
                apart_x, apart_y = _fear(x, y, sheep[b], mask[b], view, nearest, i)
                force_x = w_s * apart_x + w_v * (sum_u / others - u) + w_c * (sum_x / others - x)
                force_y = w_s * apart_y + w_v * (sum_v / others - v) + w_c * (sum_y / others - y)
            away_x, away_y = _fear(x, y, shepherds[b], shepherd_mask[b], view, nearest, -1)
            force_x, force_y = force_x + w_f * away_x, force_y + w_f * away_y
            length = np.float32(math.sqrt(force_x * force_x + force_y * force_y))
            if length > limit:
                scale = limit / max(length, _EPSILON)
                force_x, force_y = force_x * scale, force_y * scale
            way_x, way_y = _unit(u + force_x * dt, v + force_y * dt)
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
        *(np.float32(weight) for weight in weights),
        new_sheep,
        new_heading,
    )
    shape = state.sheep.shape
    return torch.from_numpy(new_sheep).reshape(shape), torch.from_numpy(new_heading).reshape(shape)
