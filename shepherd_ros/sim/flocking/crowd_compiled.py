"""The step of the crowd, compiled for the CPU."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math
from typing import Any

import numpy as np
from shepherd_ros.sim.compiled import compiled, flat_array
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import EPSILON
from shepherd_ros.sim.vectors_compiled import length, unit_xy
import torch
from torch import Tensor

_EPSILON = np.float32(EPSILON)
_ZERO, _ONE = np.float32(0), np.float32(1)


@compiled
def _push(i, xs, ys, others, mask, own, strength, scale, contact, reach):
    """Return the push of others (K, 2) m on pedestrian i, which is among them if own."""
    push_x, push_y = _ZERO, _ZERO
    for k in range(others.shape[0]):
        if mask[k] and not (own and k == i):
            dx, dy = xs[i] - others[k, 0], ys[i] - others[k, 1]
            if dx * dx + dy * dy < reach * reach:
                distance = length(dx, dy)
                if distance > _EPSILON:
                    size = strength * np.float32(math.exp((contact - distance) / scale)) / distance
                    push_x += size * dx
                    push_y += size * dy
    return push_x, push_y


@compiled
def _crowd(
    sheep, heading, mask, shepherds, shepherd_mask, target, preferred, relaxation, fastest,
    contact, a, b, reach, a_e, b_e, reach_e, h, substeps, new_sheep, new_heading,
):  # fmt: skip
    n = sheep.shape[1]
    xs, ys = np.empty(n, np.float32), np.empty(n, np.float32)
    us, vs = np.empty(n, np.float32), np.empty(n, np.float32)
    for w in range(sheep.shape[0]):
        place = sheep[w].copy()
        for i in range(n):
            xs[i], ys[i] = place[i, 0], place[i, 1]
            to_x, to_y = unit_xy(target[w, i, 0] - xs[i], target[w, i, 1] - ys[i])
            forward = max(heading[w, i, 0] * to_x + heading[w, i, 1] * to_y, _ZERO)
            us[i] = preferred[w, i] * forward * heading[w, i, 0]
            vs[i] = preferred[w, i] * forward * heading[w, i, 1]
        for _ in range(substeps):
            for i in range(n):
                to_x, to_y = unit_xy(target[w, i, 0] - xs[i], target[w, i, 1] - ys[i])
                x, y = _push(i, xs, ys, place, mask[w], True, a, b, contact, reach)
                from_x, from_y = _push(
                    i, xs, ys, shepherds[w], shepherd_mask[w], False, a_e, b_e, contact, reach_e
                )
                u = us[i] + ((preferred[w, i] * to_x - us[i]) / relaxation + x + from_x) * h
                v = vs[i] + ((preferred[w, i] * to_y - vs[i]) / relaxation + y + from_y) * h
                scale = min(fastest * preferred[w, i] / max(length(u, v), _EPSILON), _ONE)
                us[i], vs[i] = u * scale, v * scale
            for i in range(n):
                xs[i] += us[i] * h
                ys[i] += vs[i] * h
                place[i, 0], place[i, 1] = xs[i], ys[i]
        for i in range(n):
            new_sheep[w, i, 0], new_sheep[w, i, 1] = xs[i], ys[i]
            to_x, to_y = unit_xy(us[i], vs[i])
            if to_x == 0 and to_y == 0:
                to_x, to_y = heading[w, i, 0], heading[w, i, 1]
            new_heading[w, i, 0], new_heading[w, i, 1] = to_x, to_y


def crowd_step_compiled(
    state: WorldState, target: Tensor, preferred: Tensor, config: Any, dt: float, substeps: int
) -> tuple[Tensor, Tensor]:
    """Return the result of sim.flocking.crowd.crowd_step()."""
    sheep = flat_array(state.sheep, 2)
    new_sheep, new_heading = np.empty_like(sheep), np.empty_like(sheep)
    numbers = (
        config.relaxation,
        config.fastest,
        2 * config.body_radius,
        config.repulsion,
        config.repulsion_length,
        config.pedestrian_range,
        config.escort_repulsion,
        config.escort_length,
        config.escort_range,
        dt / substeps,
    )
    _crowd(
        sheep,
        flat_array(state.heading, 2),
        flat_array(state.sheep_mask, 1),
        flat_array(state.shepherds, 2),
        flat_array(state.shepherd_mask, 1),
        flat_array(target, 2),
        flat_array(preferred, 1),
        *(np.float32(number) for number in numbers),
        substeps,
        new_sheep,
        new_heading,
    )
    shape = state.sheep.shape
    return torch.from_numpy(new_sheep).reshape(shape), torch.from_numpy(new_heading).reshape(shape)
