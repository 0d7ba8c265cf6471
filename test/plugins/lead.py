"""A plug-in: a controller, shepherds that stand behind the flock."""

from __future__ import annotations

from dataclasses import dataclass

from shepherd_ros.config import Config, option
from shepherd_ros.controllers.controller import Controller, CONTROLLERS, Memory
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import clip_norm, unit
from torch import Tensor


@dataclass(frozen=True)
class LeadConfig(Config):
    """Options of the controller."""

    behind: float = option(3.0, 'distance to the center of the flock [m]', low=0.0)


@CONTROLLERS.add
class LeadController(Controller):
    """Stands behind the flock, seen from the goal."""

    name = 'lead'
    config_type = LeadConfig

    def act(self, state: WorldState, memory: Memory) -> tuple[Tensor, Memory]:
        """Return commands, (..., H, 2) m/s."""
        place = state.center + unit(state.center - state.goal) * self.config.behind
        velocity = clip_norm(place[..., None, :] - state.shepherds, self.world.shepherd_speed)
        return velocity * state.shepherd_mask[..., None], memory
