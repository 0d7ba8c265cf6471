"""Lower baseline: shepherds that stand still."""

from __future__ import annotations

from dataclasses import dataclass

from shepherd_ros.config import Config
from shepherd_ros.controllers.controller import Controller, CONTROLLERS, Memory
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor


@dataclass(frozen=True)
class IdleConfig(Config):
    """No options."""


@CONTROLLERS.add
class IdleController(Controller):
    """Commands zero velocity."""

    name = 'idle'
    config_type = IdleConfig
    executable = 'idle'
    order = 90
    style = ('#8A949B', (0, (1, 3)), 'x')

    def act(self, state: WorldState, memory: Memory) -> tuple[Tensor, Memory]:
        """Return zeros, (..., H, 2) m/s, and memory, which stays empty."""
        return torch.zeros_like(state.shepherds), memory
