"""The move of the shepherds in sim.transition."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np
from shepherd_ros.sim.compiled import compiled, flat_array
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import EPSILON
import torch
from torch import Tensor

_EPSILON = np.float32(EPSILON)


@compiled
def _move(shepherds, mask, command, top, dt, moved):
    for b in range(shepherds.shape[0]):
        for h in range(shepherds.shape[1]):
            moved[b, h, 0], moved[b, h, 1] = shepherds[b, h, 0], shepherds[b, h, 1]
            x, y = command[b, h, 0], command[b, h, 1]
            if mask[b, h] and math.isfinite(x) and math.isfinite(y):
                length = np.float32(math.hypot(x, y))  # does not overflow
                if length > top:
                    scale = top / max(length, _EPSILON)
                    x, y = x * scale, y * scale
                moved[b, h, 0] += x * dt
                moved[b, h, 1] += y * dt


def move_compiled(state: WorldState, command: Tensor, top: float, dt: float) -> Tensor:
    """Return the result of sim.transition.move()."""
    shepherds = flat_array(state.shepherds, 2)
    moved = np.empty_like(shepherds)
    numbers = np.float32(top), np.float32(dt)
    _move(shepherds, flat_array(state.shepherd_mask, 1), flat_array(command, 2), *numbers, moved)
    return torch.from_numpy(moved.reshape(state.shepherds.shape))
