"""Lower baseline: shepherds that wander at random."""

from __future__ import annotations

from dataclasses import dataclass

from shepherd_ros.config import Config, option
from shepherd_ros.controllers.controller import Controller, CONTROLLERS, Memory
from shepherd_ros.sim.rng import direction, Stream
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor


@dataclass(frozen=True)
class RandomConfig(Config):
    """Options of the random controller."""

    hold_steps: int = option(8, 'steps for which a random direction is kept', low=1)


@CONTROLLERS.add
class RandomController(Controller):
    """Commands top speed in a random direction, a new one every hold_steps."""

    name = 'random'
    config_type = RandomConfig
    executable = 'random'
    order = 91
    style = ('#B5BCC1', (0, (5, 4)), '+')

    def act(self, state: WorldState, memory: Memory) -> tuple[Tensor, Memory]:
        """Return random velocities, (..., H, 2) m/s, and memory, which stays empty."""
        index = torch.arange(state.shepherds.shape[-2], device=state.shepherds.device)
        drawn = torch.div(state.step, self.config.hold_steps, rounding_mode='floor')
        course = direction(state.seed, drawn, Stream.CONTROL, index, state.shepherds.dtype)
        return course * self.world.shepherd_speed, memory
