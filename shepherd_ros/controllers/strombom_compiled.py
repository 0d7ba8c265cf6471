"""The controller of controllers.strombom, world by world."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math
from typing import Any

import numpy as np
from shepherd_ros.sim.compiled import compiled, flat_array
from shepherd_ros.sim.rng import Stream
from shepherd_ros.sim.rng_compiled import direction_at, stream_key
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors_compiled import (
    assign_places,
    bearing_xy,
    length,
    mean,
    unit_xy,
    wrap_angle,
)
import torch
from torch import Tensor

_CONTROL = int(Stream.CONTROL)
_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)
_PI, _INF = np.float32(math.pi), np.float32(np.inf)


@compiled
def _strombom_targets(
    sheep, sheep_mask, shepherds, shepherd_mask, x, y, distance, rear, max_spread, behind, collect,
    spacing, free, target,
):  # fmt: skip
    """Write the place of each shepherd into target (H, 2), those that do not collect into free."""
    team, place = shepherds.shape[0], np.empty(shepherds.shape[0], np.float32)
    for h in range(team):
        free[h] = shepherd_mask[h]
    for _ in range(min(team, sheep.shape[0])):
        stray = 0
        for i in range(sheep.shape[0]):
            if distance[i] > distance[stray]:
                stray = i
        if not distance[stray] > max_spread:
            break
        distance[stray] = -_ONE
        nearest, shortest = -1, _INF
        for h in range(team):
            shepherd_distance = length(
                shepherds[h, 0] - sheep[stray, 0], shepherds[h, 1] - sheep[stray, 1]
            )
            if free[h] and shepherd_distance < shortest:
                nearest, shortest = h, shepherd_distance
        if nearest >= 0:
            free[nearest] = False
            away_x, away_y = unit_xy(sheep[stray, 0] - x, sheep[stray, 1] - y)
            target[nearest, 0] = sheep[stray, 0] + collect * away_x
            target[nearest, 1] = sheep[stray, 1] + collect * away_y
    around = np.empty(team, np.float32)
    for h in range(team):
        around[h] = wrap_angle(bearing_xy(shepherds[h, 0] - x, shepherds[h, 1] - y) - rear)
    assign_places(around, spacing, free, place)
    for h in range(team):
        if free[h]:
            slot = rear + place[h]
            target[h, 0] = x + behind * np.float32(math.cos(slot))
            target[h, 1] = y + behind * np.float32(math.sin(slot))


@compiled
def _detour(x, y, d, radius, stride, turn):
    """Return the course around the flock for a shepherd at x, y from its center, d metres out."""
    out_x, out_y = unit_xy(x, y)
    side = -_ONE if turn < 0 else _ONE
    along_x, along_y = -out_y * side, out_x * side
    if d < radius - stride:
        weight = (radius - d) / max(stride, np.float32(1e-9))
        return unit_xy(along_x + weight * out_x, along_y + weight * out_y)
    cosine = (d * d + stride * stride - radius * radius) / max(_TWO * d * stride, np.float32(1e-9))
    cosine = min(max(cosine, -_ONE), _ONE)
    sine = np.float32(math.sqrt(_ONE - cosine * cosine))
    return along_x * sine - out_x * cosine, along_y * sine - out_y * cosine


@compiled
def _distances(sheep, mask, x, y, distance):
    """Write distances of the present sheep from x, y into (N,) m; return largest and rms."""
    largest, total, count = _ZERO, _ZERO, _ZERO
    for i in range(sheep.shape[0]):
        distance[i] = _ZERO
        if mask[i]:
            distance[i] = length(sheep[i, 0] - x, sheep[i, 1] - y)
            largest = max(largest, distance[i])
            total += distance[i] * distance[i]
            count += _ONE
    return largest, np.float32(math.sqrt(total / count))


@compiled
def _nearest(sheep, mask, x, y):
    """Return the distance of the nearest present sheep from x, y [m]."""
    nearest = _INF
    for i in range(sheep.shape[0]):
        dx, dy = x - sheep[i, 0], y - sheep[i, 1]
        if mask[i]:
            nearest = min(nearest, dx * dx + dy * dy)
    return np.float32(math.sqrt(nearest))


@compiled
def _strombom(
    seed, step, sheep, sheep_mask, shepherds, shepherd_mask, goal, elfiqi, rms, r, standoff,
    margin, tolerance, wing_spacing, noise, stop, dt, top, velocity,
):  # fmt: skip
    n, team = sheep.shape[1], shepherds.shape[1]
    distance, free = np.empty(n, np.float32), np.empty(team, np.bool_)
    target = np.empty((team, 2), np.float32)
    stride = top * dt
    for b in range(sheep.shape[0]):
        x, y, count = mean(sheep[b], sheep_mask[b])
        size = np.float32(count)
        largest, root = _distances(sheep[b], sheep_mask[b], x, y, distance)
        radius = (root if rms else largest) + margin
        max_spread, collect = r * np.float32(size ** (2 / 3)), r
        behind = r * np.float32(math.sqrt(size))
        if elfiqi:
            max_spread, collect = r * np.float32(math.sqrt(_TWO * size)), standoff
            behind = max_spread + standoff
        spacing = wing_spacing
        if spacing == 0:
            spacing = _PI / np.float32(2 * max(int(np.count_nonzero(shepherd_mask[b])), 1))
        rear = bearing_xy(x - goal[b, 0], y - goal[b, 1])
        _strombom_targets(
            sheep[b], sheep_mask[b], shepherds[b], shepherd_mask[b], x, y, distance, rear,
            max_spread, behind, collect, spacing, free, target,
        )  # fmt: skip
        key = stream_key(seed[b], step[b], _CONTROL)
        for h in range(team):
            velocity[b, h, 0], velocity[b, h, 1] = _ZERO, _ZERO
            nearest = _nearest(sheep[b], sheep_mask[b], shepherds[b, h, 0], shepherds[b, h, 1])
            if not shepherd_mask[b, h] or nearest < stop:
                continue
            to_x, to_y = target[h, 0] - shepherds[b, h, 0], target[h, 1] - shepherds[b, h, 1]
            course_x, course_y = unit_xy(to_x, to_y)
            speed = min(length(to_x, to_y) / dt, top)
            offset_x, offset_y = shepherds[b, h, 0] - x, shepherds[b, h, 1] - y
            aim = bearing_xy(target[h, 0] - x, target[h, 1] - y)
            turn = wrap_angle(aim - bearing_xy(offset_x, offset_y))
            ahead = length(offset_x + speed * dt * course_x, offset_y + speed * dt * course_y)
            if abs(turn) > tolerance and ahead < radius:
                d = length(offset_x, offset_y)
                course_x, course_y = _detour(offset_x, offset_y, d, radius, stride, turn)
                speed = top
            if noise > 0:
                random_x, random_y = direction_at(key, h)
                course_x, course_y = unit_xy(
                    course_x + noise * random_x, course_y + noise * random_y
                )
            velocity[b, h, 0], velocity[b, h, 1] = speed * course_x, speed * course_y


def strombom_act(
    state: WorldState, config: Any, r: float, stop: float, dt: float, top: float
) -> Tensor:
    """Return the command of controllers.strombom; r and stop [m], dt [s], top speed [m/s]."""
    shepherds = flat_array(state.shepherds, 2)
    velocity = np.empty_like(shepherds)
    numbers = (
        r,
        config.standoff,
        config.arc_margin or 3 * r,
        config.arc_tolerance,
        config.wing_spacing,
        config.noise,
        stop,
        dt,
        top,
    )
    _strombom(
        flat_array(state.seed, 0),
        flat_array(state.step, 0),
        flat_array(state.sheep, 2),
        flat_array(state.sheep_mask, 1),
        shepherds,
        flat_array(state.shepherd_mask, 1),
        flat_array(state.goal, 1),
        config.position_law == 'elfiqi',
        config.arc == 'rms',
        *(np.float32(number) for number in numbers),
        velocity,
    )
    return torch.from_numpy(velocity.reshape(state.shepherds.shape))
