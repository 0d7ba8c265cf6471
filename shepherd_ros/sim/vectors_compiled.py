"""The vectors of sim.vectors, and places on an arc, in numbers of float32."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np
from shepherd_ros.sim.compiled import compiled
from shepherd_ros.sim.vectors import EPSILON

_EPSILON = np.float32(EPSILON)
_ZERO, _TWO = np.float32(0), np.float32(2)
_PI, _TURN = np.float32(math.pi), np.float32(2 * math.pi)


@compiled
def length(x, y):
    """Return the length of a vector."""
    return np.float32(math.sqrt(x * x + y * y))


@compiled
def unit_xy(x, y):
    """Return the unit vector, 0 where it is shorter than EPSILON."""
    size = length(x, y)
    if size < _EPSILON:
        return _ZERO, _ZERO
    return x / size, y / size


@compiled
def wrap_angle(angle):
    """Return the angle in [-pi, pi) rad."""
    return (angle + _PI) % _TURN - _PI


@compiled
def bearing_xy(x, y):
    """Return the angle of a vector from +x [rad]."""
    return np.float32(math.atan2(y, x))


@compiled
def mean(points, mask):
    """Return x and y of the mean of the present points (K, 2), and their number."""
    count, x, y = 0, _ZERO, _ZERO
    for k in range(points.shape[0]):
        if mask[k]:
            count += 1
            x += points[k, 0]
            y += points[k, 1]
    size = np.float32(max(count, 1))
    return x / size, y / size, count


@compiled
def assign_places(around, spacing, mask, place):
    """Write the angles of controllers.controller.places_on_arc() of one team into place (H,)."""
    team = around.shape[0]
    rank = np.zeros(team, np.int64)
    count = 0
    for h in range(team):
        count += mask[h]
        for k in range(team):
            before = around[k] < around[h] or (around[k] == around[h] and k < h)
            rank[h] += mask[k] and before
    count = max(count, 1)
    middle = np.float32(count - 1) / _TWO
    lowest, best = np.float32(np.inf), 0
    for shift in range(count):
        total_turn = _ZERO
        for h in range(team):
            if mask[h]:
                angle = (np.float32((rank[h] + shift) % count) - middle) * spacing
                total_turn += abs(wrap_angle(angle - around[h]))
        total_turn = np.float32(round(total_turn * np.float32(1e4)))
        if total_turn < lowest:
            lowest, best = total_turn, shift
    for h in range(team):
        place[h] = (np.float32((rank[h] + best) % count) - middle) * spacing
