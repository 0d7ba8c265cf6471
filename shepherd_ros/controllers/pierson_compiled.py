"""The controller of controllers.pierson, world by world."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math
from typing import Any

import numpy as np
from shepherd_ros.sim.compiled import compiled, flat_array
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import EPSILON
from shepherd_ros.sim.vectors_compiled import assign_places, bearing_xy, mean, unit_xy, wrap_angle
import torch
from torch import Tensor

_EPSILON = np.float32(EPSILON)
_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)
_PI, _TURN = np.float32(math.pi), np.float32(2 * math.pi)


@compiled
def _push_fraction(opening, team):
    half = opening / max(_TWO * team - _TWO, _ONE)
    if half < np.float32(1e-4):
        return _ONE
    below = max(team * np.float32(math.sin(half)), np.float32(1e-9))
    return np.float32(math.sin(team * half)) / below


@compiled
def _opening(share, team):
    """Return the opening [rad] of a push fraction, which falls from 1 to 0, by bisection."""
    low, width = _ZERO, _TURN * (team - _ONE) / team
    for _ in range(25):
        width /= _TWO
        if _push_fraction(low + width, team) >= share:
            low += width
    return low + width / _TWO


@compiled
def _spread(sheep, mask, x, y, count):
    """Return the standard distance of the present sheep from their mean x, y [m]."""
    var_x, var_y = _ZERO, _ZERO
    for i in range(sheep.shape[0]):
        if mask[i]:
            dx, dy = sheep[i, 0] - x, sheep[i, 1] - y
            var_x += dx * dx
            var_y += dy * dy
    return np.float32(math.sqrt(var_x / np.float32(count) + var_y / np.float32(count)))


@compiled
def _toward(x, y, constant, tracking, top):
    """Return the velocity of a shepherd whose place is x, y [m] from it."""
    if constant:
        x, y = unit_xy(x, y)
        return top * x, top * y
    x, y = tracking * x, tracking * y
    length = np.float32(math.hypot(x, y))
    scale = top / max(length, _EPSILON) if length > top else _ONE
    return scale * x, scale * y


@compiled
def _pierson(
    sheep, sheep_mask, shepherds, shepherd_mask, goal, heading, sorted_places, constant,
    lead, gain, max_turn_rate, weakest, strongest, spread_factor, min_radius, max_radius, tracking,
    pace, dt, top, velocity, new_heading,
):  # fmt: skip
    size = shepherds.shape[1]
    around, place = np.empty(size, np.float32), np.empty(size, np.float32)
    for b in range(sheep.shape[0]):
        x, y, count = mean(sheep[b], sheep_mask[b])
        spread = _spread(sheep[b], sheep_mask[b], x, y, count)
        cos, sin = np.float32(math.cos(heading[b])), np.float32(math.sin(heading[b]))
        lead_x, lead_y = x + lead * cos - goal[b, 0], y + lead * sin - goal[b, 1]
        speed = -gain * (lead_x * cos + lead_y * sin)
        turn_rate = -gain / lead * (lead_y * cos - lead_x * sin)
        turn_rate = min(max(turn_rate, -max_turn_rate), max_turn_rate)
        course = wrap_angle(heading[b] + turn_rate * dt)
        new_heading[b] = course

        team = np.float32(np.count_nonzero(shepherd_mask[b]))
        share = min(max(speed / pace, weakest), strongest)
        radius = min(max(spread_factor * spread, min_radius), max_radius)
        rear, spacing = course + _PI, _ZERO
        if team == 1:
            rear = bearing_xy(goal[b, 0] - x, goal[b, 1] - y) + _PI
        else:
            spacing = _opening(share, max(team, _TWO)) / max(team - _ONE, _ONE)
        if sorted_places:
            for h in range(size):
                around[h] = wrap_angle(
                    bearing_xy(shepherds[b, h, 0] - x, shepherds[b, h, 1] - y) - rear
                )
            assign_places(around, spacing, shepherd_mask[b], place)
        else:
            for h in range(size):
                place[h] = (np.float32(h) - (team - _ONE) / _TWO) * spacing
        for h in range(size):
            velocity[b, h, 0], velocity[b, h, 1] = _ZERO, _ZERO
            if shepherd_mask[b, h]:
                angle = rear + place[h]
                to_x = x + radius * np.float32(math.cos(angle)) - shepherds[b, h, 0]
                to_y = y + radius * np.float32(math.sin(angle)) - shepherds[b, h, 1]
                to_x, to_y = _toward(to_x, to_y, constant, tracking, top)
                velocity[b, h, 0], velocity[b, h, 1] = to_x, to_y


def pierson_act(
    state: WorldState,
    heading: Tensor,
    config: Any,
    max_radius: float,
    tracking: float,
    pace: float,
    dt: float,
    top: float,
) -> tuple[Tensor, Tensor]:
    """Return the command of controllers.pierson; pace is the sheep's speed, top the shepherds'."""
    shepherds, course = flat_array(state.shepherds, 2), flat_array(heading, 0)
    velocity, new_heading = np.empty_like(shepherds), np.empty_like(course)
    numbers = (
        config.lead,
        config.gain,
        config.max_turn_rate,
        config.weakest_push,
        config.strongest_push,
        config.spread_factor,
        config.min_radius,
        max_radius,
        tracking,
        pace,
        dt,
        top,
    )
    _pierson(
        flat_array(state.sheep, 2),
        flat_array(state.sheep_mask, 1),
        shepherds,
        flat_array(state.shepherd_mask, 1),
        flat_array(state.goal, 1),
        course,
        config.assignment == 'sorted',
        config.pace == 'constant',
        *(np.float32(number) for number in numbers),
        velocity,
        new_heading,
    )
    shape = state.shepherds.shape
    return (
        torch.from_numpy(velocity.reshape(shape)),
        torch.from_numpy(new_heading.reshape(heading.shape)),
    )
