"""The step of the Strömbom flock, compiled for the CPU."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math
from typing import Any

import numpy as np
from shepherd_ros.sim.kernels import compiled, flat
from shepherd_ros.sim.kernels.grid import build, nothing, sum_of_nearest, within
from shepherd_ros.sim.kernels.noise import direction_at, key_of, uniform_at
from shepherd_ros.sim.kernels.vectors import length, unit
from shepherd_ros.sim.noise import Stream
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import EPSILON
import torch
from torch import Tensor

_TURN, _GRAZE = int(Stream.TURN), int(Stream.GRAZE)
_EPSILON = np.float32(EPSILON)
_ZERO, _ONE = np.float32(0), np.float32(1)
_FEW = 27  # sheep that are too many are searched for one by one up to here, else on a grid
_SLACK = np.float32(1e-5)  # of the flock's extent: far more than distances are rounded by


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
def _push_by(x, y, others, candidates, count, reach):
    """Return the first two of _push() by those of the others that are candidates."""
    push_x, push_y = _ZERO, _ZERO
    for k in range(count):
        j = candidates[k]
        dx, dy = x - others[j, 0], y - others[j, 1]
        squared = dx * dx + dy * dy
        if _EPSILON * _EPSILON < squared < reach * reach:
            inverse = _ONE / np.float32(math.sqrt(squared))
            push_x += dx * inverse
            push_y += dy * inverse
    return push_x, push_y


@compiled
def _sum_of_farthest(i, sheep, near, order, out, slack, keep, best, index):
    """
    Return the sum of near (N, 2) over the keep sheep farthest from sheep i.

    order is who is present, far to near, and out [m] how far from the center: nobody is farther
    from i than both are out together, so the search ends early.
    """
    found = 0
    for j in order:
        if found == keep:
            farthest = out[i] + out[j] + slack
            if farthest * farthest < best[keep - 1]:
                break
        if j == i:
            continue
        dx, dy = sheep[i, 0] - sheep[j, 0], sheep[i, 1] - sheep[j, 1]
        squared = dx * dx + dy * dy
        k = found if found < keep else keep
        while k > 0 and (best[k - 1] < squared or (best[k - 1] == squared and index[k - 1] > j)):
            k -= 1
        if k == keep:
            continue
        found = min(found + 1, keep)
        for m in range(found - 1, k, -1):
            best[m], index[m] = best[m - 1], index[m - 1]
        best[k], index[k] = squared, j
    sum_x, sum_y = _ZERO, _ZERO
    for k in range(found):
        sum_x += near[index[k], 0]
        sum_y += near[index[k], 1]
    return sum_x, sum_y


@compiled
def _from_the_rim(near, mask, x, y, out, order):
    """Write how far from x, y each sheep is into out (N,) m; return the present, far to near."""
    count = 0
    for j in range(near.shape[0]):
        out[j] = length(near[j, 0] - x, near[j, 1] - y)
        if mask[j]:
            k = count
            while k > 0 and out[order[k - 1]] < out[j]:
                order[k] = order[k - 1]
                k -= 1
            order[k] = j
            count += 1
    return order[:count]


@compiled
def _strombom(
    seed, step, sheep, heading, mask, shepherds, shepherd_mask, n_neighbors, shepherd_range,
    sheep_range, rho_a, c, rho_s, h, e, p, stride, normalize, metric, new_sheep, new_heading,
):  # fmt: skip
    n = sheep.shape[1]
    out, best = np.empty(n, np.float32), np.empty(n, np.float32)
    near = np.empty((n, 2), np.float32)
    index, places = np.empty(n, np.int64), np.empty(n, np.int64)
    for b in range(sheep.shape[0]):
        turn, graze = key_of(seed[b], step[b], _TURN), key_of(seed[b], step[b], _GRAZE)
        others = -1
        sum_x, sum_y = _ZERO, _ZERO
        # relative to one sheep: means of far places would be rounded by more than sheep differ
        for j in range(n):
            near[j, 0] = sheep[b, j, 0] - sheep[b, 0, 0]
            near[j, 1] = sheep[b, j, 1] - sheep[b, 0, 1]
            if mask[b, j]:
                others += 1
                sum_x += near[j, 0]
                sum_y += near[j, 1]
        far = others - n_neighbors
        count = min(others, n_neighbors)
        few_far = 0 < far <= _FEW
        order, slack = places, _ZERO
        many_far = far > _FEW
        grid = build(sheep[b], mask[b]) if many_far else nothing()
        if few_far:
            size = np.float32(others + 1)
            order = _from_the_rim(near, mask[b], sum_x / size, sum_y / size, out, places)
            slack = _SLACK * out[order[0]]
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
                    if few_far:
                        far_x, far_y = _sum_of_farthest(
                            i, sheep[b], near, order, out, slack, far, best, index
                        )
                        to_x, to_y = to_x - far_x, to_y - far_y
                    elif many_far:
                        to_x, to_y = sum_of_nearest(i, sheep[b], near, count, grid, index, best)
                    to_x = to_x / np.float32(count) - near[i, 0]
                    to_y = to_y / np.float32(count) - near[i, 1]
                if not metric:
                    to_x, to_y = unit(to_x, to_y)
                if many_far:
                    met = within(i, sheep_range, grid, index)
                    apart_x, apart_y = _push_by(x, y, sheep[b], index, met, sheep_range)
                else:
                    apart_x, apart_y, _ = _push(x, y, sheep[b], mask[b], sheep_range)
                apart_x, apart_y = unit(apart_x, apart_y)
                if normalize:
                    away_x, away_y = unit(away_x, away_y)
                new_x, new_y = unit(
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
