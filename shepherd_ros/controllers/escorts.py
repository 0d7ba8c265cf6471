"""
Escorts by rule, to compare with: ring, wedge, greedy block, huddle and interception.

All move with the payload: their places are those of the next step.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from shepherd_ros.config import Config, option
from shepherd_ros.controllers.controller import Controller, CONTROLLERS, Memory, places_on_arc
from shepherd_ros.sim.goal_motion import moved_goal
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import bearing, clip_norm, EPSILON, from_bearing, unit, wrap
import torch
from torch import Tensor

BODY = 0.5  # [m] radius of the payload's body


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


@dataclass(frozen=True)
class InterceptConfig(Config):
    """Options of the interception."""

    horizon: float = option(4.0, 'pedestrians that arrive within this time count [s]', low=0.0)
    clearance: float = option(1.2, 'arrive: come so near to the rim of the region [m]', low=0.0)
    approach: float = option(0.9, 'distance to a pedestrian at which it is met [m]', low=0.0)
    pace: float = option(0.35, 'speed that a pedestrian is taken to have [m/s]', low=0.0)


class Escorts(Controller):
    """Escorts that go to places at the next step's payload at their top speed."""

    def act(self, state: WorldState, memory: Memory) -> tuple[Tensor, Memory]:
        """Return velocities toward the places, (..., H, 2) m/s, and memory, which stays empty."""
        payload = moved_goal(state, self.world)
        place = payload[..., None, :] + self.places(state, payload)
        speed, dt = self.world.shepherd_speed, self.world.dt
        command = clip_norm((place - state.shepherds) / dt, speed)
        return torch.where(state.shepherd_mask[..., None], command, 0.0), memory

    def course(self, state: WorldState) -> Tensor:
        """Return the bearing of the payload's way, (..., 1) rad."""
        return bearing(state.destination - state.goal)[..., None]

    def places(self, state: WorldState, payload: Tensor) -> Tensor:
        """Return the places around the payload (..., 2) m at the next step, (..., H, 2) m."""
        raise NotImplementedError

    def on_arc(self, state: WorldState, spacing: Tensor, margin: float) -> Tensor:
        """Return places at a margin [m] to the rim, spaced (..., 1) rad; (..., H, 2) m."""
        course = self.course(state)
        around = wrap(bearing(state.shepherds - state.goal[..., None, :]) - course)
        directions = from_bearing(course + places_on_arc(around, spacing, state.shepherd_mask))
        return (state.goal_radius + margin)[..., None, None] * directions


def even(state: WorldState) -> Tensor:
    """Return the angle between even places all around, (..., 1) rad."""
    return 2 * math.pi / state.team_size[..., None].clamp(min=1)


def met(place: Tensor, urgency: Tensor, others: Tensor, escorts: Tensor, mask: Tensor) -> Tensor:
    """
    Return places of escorts (..., H, 2) m: those of pedestrians, or others where none is left.

    The most urgent pedestrian gets the escort nearest to its place (..., N, 2) m, then the next
    one; urgency (..., N) is inf where a pedestrian needs none. mask (..., H) bool.
    """
    free, waiting = mask, urgency
    for _ in range(escorts.shape[-2]):
        next_one = waiting.argmin(dim=-1, keepdim=True)  # (..., 1)
        found = waiting.gather(-1, next_one).isfinite()
        own = place.gather(-2, next_one[..., None].expand(*next_one.shape, 2))  # (..., 1, 2)
        length = torch.linalg.vector_norm(own - escorts, dim=-1)
        escort = torch.where(free, length, torch.inf).argmin(dim=-1, keepdim=True)
        taken = torch.zeros_like(free).scatter(-1, escort, True) & free & found
        others = torch.where(taken[..., None], own, others)
        free = free & ~taken
        waiting = waiting.scatter(-1, next_one, torch.inf)
    return others


@CONTROLLERS.add
class RingController(Escorts):
    """Even places all around the payload."""

    name = 'ring'
    config_type = EscortConfig
    label = 'static ring'
    order = 20
    style = ('#0072B2', '-', 'o')
    config: EscortConfig

    def places(self, state: WorldState, payload: Tensor) -> Tensor:
        """Return the places of a ring, (..., H, 2) m."""
        return self.on_arc(state, even(state), self.config.margin)


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
        """Return the places of an arc, (..., H, 2) m."""
        gaps = (state.team_size[..., None] - 1).clamp(min=1)
        return self.on_arc(state, self.config.opening / gaps, self.config.margin)


@CONTROLLERS.add
class BlockController(Escorts):
    """
    Each escort between the payload and the nearest pedestrian that walks toward it.

    Escorts without one stand on the ring.
    """

    name = 'block'
    config_type = EscortConfig
    label = 'greedy block'
    order = 22
    style = ('#009E73', '-.', 's')
    config: EscortConfig

    def places(self, state: WorldState, payload: Tensor) -> Tensor:
        """Return the places, (..., H, 2) m."""
        offset = state.sheep - payload[..., None, :]
        approaching = ((state.heading * offset).sum(dim=-1) < 0) & state.sheep_mask
        urgency = torch.where(approaching, torch.linalg.vector_norm(offset, dim=-1), torch.inf)
        rim = (state.goal_radius + self.config.margin)[..., None, None] * unit(offset)
        others = self.on_arc(state, even(state), self.config.margin)
        escorts = state.shepherds - payload[..., None, :]
        return met(rim, urgency, others, escorts, state.shepherd_mask)


@CONTROLLERS.add
class HuddleController(Escorts):
    """All escorts at the middle of the payload, which no rule of the world keeps them out of."""

    name = 'huddle'
    config_type = Config
    label = 'huddle'
    order = 23
    style = ('#D55E00', ':', 'v')

    def places(self, state: WorldState, payload: Tensor) -> Tensor:
        """Return the places, (..., H, 2) m."""
        return torch.zeros_like(state.shepherds)


@CONTROLLERS.add
class InterceptController(Escorts):
    """
    Each escort close to the pedestrian that enters the region next, on its side of the payload.

    Who enters follows from constant velocities of pedestrians and payload. Escorts without one
    stay at the middle of the payload.
    """

    name = 'intercept'
    config_type = InterceptConfig
    label = 'interception'
    order = 24
    style = ('#CC79A7', (0, (3, 1, 1, 1)), 'D')
    config: InterceptConfig

    def places(self, state: WorldState, payload: Tensor) -> Tensor:
        """Return the places, (..., H, 2) m."""
        offset = state.sheep - payload[..., None, :]
        distance = torch.linalg.vector_norm(offset, dim=-1)
        reach = (distance - self.config.approach).clamp(min=BODY)
        place = reach[..., None] * unit(offset)
        urgency = torch.where(state.sheep_mask, self.arrival(state, payload), torch.inf)
        escorts = state.shepherds - payload[..., None, :]
        return met(place, urgency, torch.zeros_like(escorts), escorts, state.shepherd_mask)

    def arrival(self, state: WorldState, payload: Tensor) -> Tensor:
        """
        Return the times until pedestrians come near the region, (..., N) s; inf if they do not.

        For those that are near they are negative, the less the nearer they are.
        """
        offset = state.sheep - payload[..., None, :]
        velocity = self.config.pace * state.heading
        velocity = velocity - ((payload - state.goal) / self.world.dt)[..., None, :]
        rim = (state.goal_radius + self.config.clearance)[..., None]
        # time at which |offset + time velocity| = rim
        a = (velocity * velocity).sum(dim=-1).clamp(min=EPSILON)
        b = (offset * velocity).sum(dim=-1)
        c = (offset * offset).sum(dim=-1) - rim * rim
        root = b * b - a * c
        time = (-b - root.clamp(min=0).sqrt()) / a
        time = torch.where((root < 0) | (time < 0) | (time > self.config.horizon), torch.inf, time)
        return torch.where(c <= 0, c, time)
