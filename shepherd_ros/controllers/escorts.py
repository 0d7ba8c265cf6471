"""
Escorts by rule: a static ring, a wedge ahead, and a greedy block, to compare with.

All move with the payload: their places are those of the next step.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from shepherd_ros.config import Config, option
from shepherd_ros.controllers.controller import Controller, CONTROLLERS, Memory, places_on_arc
from shepherd_ros.sim.goal_motion import moved_goal
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import bearing, clip_norm, from_bearing, unit, wrap
import torch
from torch import Tensor


@dataclass(frozen=True)
class EscortConfig(Config):
    """Options of escorts by rule."""

    margin: float = option(1.5, 'distance of the places to the rim of the region [m]', low=0.0)


@dataclass(frozen=True)
class WedgeConfig(EscortConfig):
    """Options of the wedge."""

    opening: float = option(
        2 * math.pi / 3, 'angle between its outermost places [rad]', low=0.0, high=2 * math.pi
    )


class Escorts(Controller):
    """Escorts that go to places at the next step's payload at their top speed."""

    config: EscortConfig

    def act(self, state: WorldState, memory: Memory) -> tuple[Tensor, Memory]:
        """Return velocities toward the places, (..., H, 2) m/s, and memory, which stays empty."""
        payload = moved_goal(state, self.world)
        ring = (state.goal_radius + self.config.margin)[..., None, None]
        place = payload[..., None, :] + ring * self.places(state, payload)
        speed, dt = self.world.shepherd_speed, self.world.dt
        command = clip_norm((place - state.shepherds) / dt, speed)
        return torch.where(state.shepherd_mask[..., None], command, 0.0), memory

    def course(self, state: WorldState) -> Tensor:
        """Return the bearing of the payload's way, (..., 1) rad."""
        return bearing(state.destination - state.goal)[..., None]

    def places(self, state: WorldState, payload: Tensor) -> Tensor:
        """Return the directions of the places from the payload (..., 2) m; (..., H, 2)."""
        raise NotImplementedError

    def on_arc(self, state: WorldState, spacing: Tensor) -> Tensor:
        """Return directions spaced (..., 1) rad around the course, (..., H, 2)."""
        course = self.course(state)
        around = wrap(bearing(state.shepherds - state.goal[..., None, :]) - course)
        return from_bearing(course + places_on_arc(around, spacing, state.shepherd_mask))


@CONTROLLERS.add
class RingController(Escorts):
    """Even places all around the payload."""

    name = 'ring'
    config_type = EscortConfig
    label = 'static ring'
    order = 20
    style = ('#0072B2', '-', 'o')

    def places(self, state: WorldState, payload: Tensor) -> Tensor:
        """Return the directions of a ring, (..., H, 2)."""
        return self.on_arc(state, 2 * math.pi / state.team_size[..., None].clamp(min=1))


@CONTROLLERS.add
class WedgeController(Escorts):
    """Even places on an arc ahead of the payload."""

    name = 'wedge'
    config_type = WedgeConfig
    label = 'leading wedge'
    order = 21
    style = ('#E69F00', '--', '^')
    config: WedgeConfig

    def places(self, state: WorldState, payload: Tensor) -> Tensor:
        """Return the directions of an arc, (..., H, 2)."""
        gaps = (state.team_size[..., None] - 1).clamp(min=1)
        return self.on_arc(state, self.config.opening / gaps)


@CONTROLLERS.add
class BlockController(Escorts):
    """
    Each escort between the payload and an approaching pedestrian.

    The nearest pedestrian that heads for the payload gets the escort nearest to its place, then
    the next one; escorts without one stand on the ring.
    """

    name = 'block'
    config_type = EscortConfig
    label = 'greedy block'
    order = 22
    style = ('#009E73', '-.', 's')

    def places(self, state: WorldState, payload: Tensor) -> Tensor:
        """Return the directions of the places, (..., H, 2)."""
        place = self.on_arc(state, 2 * math.pi / state.team_size[..., None].clamp(min=1))
        offset = state.sheep - payload[..., None, :]
        approaching = ((state.heading * offset).sum(dim=-1) < 0) & state.sheep_mask
        waiting = torch.where(approaching, torch.linalg.vector_norm(offset, dim=-1), torch.inf)
        toward, free = unit(offset), state.shepherd_mask
        ring = (state.goal_radius + self.config.margin)[..., None, None]
        for _ in range(state.shepherds.shape[-2]):
            nearest = waiting.argmin(dim=-1, keepdim=True)  # (..., 1)
            found = waiting.gather(-1, nearest).isfinite()
            course = toward.gather(-2, nearest[..., None].expand(*nearest.shape, 2))  # (..., 1, 2)
            length = torch.linalg.vector_norm(
                payload[..., None, :] + ring * course - state.shepherds, dim=-1
            )
            escort = torch.where(free, length, torch.inf).argmin(dim=-1, keepdim=True)
            taken = torch.zeros_like(free).scatter(-1, escort, True) & free & found
            place = torch.where(taken[..., None], course, place)
            free = free & ~taken
            waiting = waiting.scatter(-1, nearest, torch.inf)
        return place
