"""
The drover, a heuristic of this project: drives from far behind, stops once the flock is home.

Pushes do not grow with nearness in the Strömbom flock, and sheep rest while nobody is near. So the
team stands on an arc behind the flock, seen from the goal, as far as it can and still be noticed;
it need not follow the flock, only turn about the goal. As the flock comes home the arc opens into
a ring, from where only sheep far from the middle notice it. Sheep that never rest notice it from
nearer; it runs to its ring, which is so narrow that they are turned back wherever they go. One or
two shepherds cannot close it: they run around such a flock and only ever touch its rim, so that it
turns back and forth over the goal. A lone shepherd circles a flock that rests, and so turns back
whoever is about to leave. Shepherds that come near each other pass on the right.

Its commands follow from the present state alone: it has no memory, so that a policy can learn it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from shepherd_ros.config import Config, ConfigError, option
from shepherd_ros.controllers.controller import Controller, CONTROLLERS, Memory
from shepherd_ros.controllers.formation import (
    bearings_in_order,
    detour,
    Formation,
    FULL_TURN,
    middle_of_ring,
    separation,
)
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import bearing, clip_norm, from_bearing, masked_mean
import torch
from torch import Tensor

EDGE_OVER_RMS = 2**0.5  # of a disc, over the root mean square distance from its middle
TURN_DISTANCE = 0.75  # [goal radii] from the middle of the goal, within which a flock is turned
CLOSED_GAP = 4.0  # [rad] a team without a wider gap stands on a ring
CIRCLE_LEAD = 1.0  # [rad] so far ahead lies the place of a shepherd that circles


@dataclass(frozen=True)
class DroverConfig(Config):
    """Options of the drover; all are choices."""

    notice_range: float = option(
        0.0, 'sheep notice shepherds so near [m]; 0: as the flock of the world', low=0.0
    )
    standoff: float = option(4.5, 'least distance to the flock while driving [m]', low=0.0)
    separation: float = option(
        1.5, 'shepherds nearer to each other than this make way [m]; 0: none does', low=0.0
    )
    spacing: float = option(0.25, 'angle between neighbours on the arc [rad]', low=0.0)
    ring_reach: float = option(
        0.0,
        'sheep so far from the middle notice the ring, in goal radii, negative: all inside notice '
        'it; 0: as suits the flock',
        low=-1.0,
        high=1.0,
    )
    gain: float = option(0.5, 'speed over the distance to a place, K_d [1/s]', low=0.01)
    open_from: float = option(
        1.5, 'the arc begins to open with the flock so near the goal [goal radii]', low=0.0
    )
    open_until: float = option(0.1, 'and is a ring with it so near [goal radii]', low=0.0)
    close_share: float = option(
        0.8, 'share inside with which a ring closes about sheep that never rest', low=0.0, high=1.0
    )
    reopen_share: float = option(0.5, 'and with less than this it opens', low=0.0, high=1.0)
    lone_share: float = option(
        0.7,
        'share inside with which a lone shepherd circles sheep that rest',
        low=0.0,
        high=1.0,
    )
    lone_reach: float = option(
        0.6, 'sheep so far from the middle notice it [goal radii]', low=-1.0, high=1.0
    )
    lone_speed: float = option(0.4, 'pace on that circle, of the top speed', low=0.01, high=1.0)
    ring_speed: float = option(
        0.25, 'pace on a ring about sheep that rest, of the top speed', low=0.01, high=1.0
    )
    touch_depth: float = option(
        0.4, 'one or two touch a flock that never rests by so much of its view [m]', low=0.0
    )
    touch_distance: float = option(
        1.5, 'they do while its middle is so near the goal [goal radii]', low=0.0
    )
    touch_angle: float = option(
        1.0, 'and turn it so far from the way to the goal, in the goal itself [rad]', low=0.0
    )
    touch_spacing: float = option(1.0, 'angle between two who do [rad]', low=0.0)

    def __post_init__(self) -> None:
        """Check each field, and that the arc opens before it is a ring."""
        super().__post_init__()
        if self.open_until >= self.open_from:
            raise ConfigError(
                f'open_until is {self.open_until}: expected less than open_from, {self.open_from}'
            )


class Ring(NamedTuple):
    """Ring about a flock in the goal: its size, and the shepherds that close it."""

    reach: float  # the option of that name [goal radii]
    least: int  # shepherds that can close it


WIDE_RING = Ring(0.45, 2)  # about sheep that rest when nobody is near
NARROW_RING = Ring(-0.15, 3)  # about sheep that never rest


def fraction_inside(state: WorldState) -> Tensor:
    """Return the fraction of the flock in the goal, (..., 1)."""
    return (state.inside.sum(dim=-1) / state.flock_size)[..., None]


@CONTROLLERS.add
class DroverController(Controller):
    """Drives until all sheep are inside, then stops until some are outside again."""

    name = 'drover'
    config_type = DroverConfig
    executable = 'drover'
    label = 'drover (ours)'
    order = 12
    style = ('#CC79A7', '-.', 'D')

    def __init__(self, *args: Any, **options: Any) -> None:
        """Select ring and pace for the flock of the world."""
        super().__init__(*args, **options)
        config: DroverConfig = self.config
        self.restless = self.world.flock.restless
        ring = NARROW_RING if self.restless else WIDE_RING
        self.notice = config.notice_range or self.world.flock.notice_range
        self.pace = 1.0 if self.restless else config.ring_speed
        self.reach, self.least = config.ring_reach or ring.reach, ring.least

    def act(self, state: WorldState, memory: Memory) -> tuple[Tensor, Memory]:
        """Return commands (..., H, 2) m/s, and memory, which stays empty."""
        goal, center = state.goal[..., None, :], state.center[..., None, :]  # (..., 1, 2) m
        behind = bearing(center - goal)  # (..., 1) rad
        goal_distance = torch.linalg.vector_norm(center - goal, dim=-1)
        squared = (state.sheep - center).square().sum(dim=-1)  # (..., N) m2
        flock_radius = EDGE_OVER_RMS * masked_mean(squared[..., None], state.sheep_mask).sqrt()
        too_small = state.team_size[..., None] < self.least
        clearance = flock_radius + self.config.standoff

        formation = self._arc_or_ring(state, behind, goal_distance, clearance)
        if self.restless:
            near = goal_distance < self.config.touch_distance * state.goal_radius[..., None]
            formation = self._touch_formation(state, behind, goal_distance, flock_radius).where(
                too_small & near, formation
            )
        else:
            inside = fraction_inside(state) >= self.config.lone_share
            formation = self._lone_formation(state, formation).where(too_small & inside, formation)

        place = formation.places(state)
        target = formation.about + formation.distance[..., None] * from_bearing(place)
        gain, speed = self.config.gain, self.world.shepherd_speed
        along = formation.displacement_along(state, place, gain)
        displacement = torch.where(
            formation.along[..., None], along, detour(state, target, center, clearance)
        )
        avoidance = separation(state, self.config.separation) * speed
        return clip_norm(clip_norm(displacement * gain, speed) + avoidance, speed), memory

    def _arc_or_ring(
        self, state: WorldState, behind: Tensor, goal_distance: Tensor, clearance: Tensor
    ) -> Formation:
        """Return the arc behind the flock, the ring about the goal, or a mean of the two."""
        config, goal = self.config, state.goal[..., None, :]
        radius, team = state.goal_radius[..., None], state.team_size[..., None]
        angle = bearing(state.shepherds - goal)
        if self.restless:  # in haste
            gap = bearings_in_order(angle, state.shepherd_mask)[1].amax(dim=-1, keepdim=True)
            threshold = torch.where(gap < CLOSED_GAP, config.reopen_share, config.close_share)
            arc = (fraction_inside(state) < threshold).to(goal_distance.dtype)
        else:
            arc = goal_distance / radius - config.open_until
            arc = (arc / (config.open_from - config.open_until)).clamp(0.0, 1.0)
        arc = torch.where(team < self.least, 1.0, arc)
        angle_each = FULL_TURN / team
        # a ring is where the team is; all turns by a part give the same places
        turn = middle_of_ring(angle, state.shepherd_mask)[..., None] - behind
        turn = torch.remainder(turn + angle_each / 2, angle_each) - angle_each / 2
        driving = (goal_distance + clearance).clamp(min=self.notice)
        ring = self.notice + self.reach * radius
        return Formation(
            about=goal,
            distance=arc * driving + (1 - arc) * ring,
            middle=behind + (1 - arc) * turn,
            spacing=arc * config.spacing + (1 - arc) * angle_each,
            along=arc < 1,
            pace=torch.full_like(arc, self.pace) * self.world.shepherd_speed,
            even=arc == 0,
        )

    def _lone_formation(self, state: WorldState, formation: Formation) -> Formation:
        """Return the circle of a lone shepherd about the goal, counter-clockwise."""
        goal, config = state.goal[..., None, :], self.config
        angle = bearing(masked_mean(state.shepherds, state.shepherd_mask)[..., None, :] - goal)
        return replace(
            formation,
            distance=self.notice + config.lone_reach * state.goal_radius[..., None],
            middle=angle + CIRCLE_LEAD,
            along=torch.ones_like(formation.along),
            pace=torch.full_like(formation.pace, config.lone_speed * self.world.shepherd_speed),
            even=torch.zeros_like(formation.even),
        )

    def _touch_formation(
        self, state: WorldState, behind: Tensor, goal_distance: Tensor, flock_radius: Tensor
    ) -> Formation:
        """Return the formation at the rim of a flock, to turn it on its path over the goal."""
        heading = bearing(masked_mean(state.heading, state.sheep_mask))[..., None]
        side = torch.where(torch.sin(heading - behind) >= 0, 1.0, -1.0)
        crossing = (1 - goal_distance / (TURN_DISTANCE * state.goal_radius[..., None])).clamp(
            min=0.0
        )
        return Formation(
            about=state.center[..., None, :],
            distance=flock_radius + self.notice - self.config.touch_depth,
            middle=behind - side * self.config.touch_angle * crossing,
            spacing=torch.full_like(goal_distance, self.config.touch_spacing),
            along=torch.ones_like(goal_distance, dtype=torch.bool),
            pace=torch.full_like(goal_distance, self.world.shepherd_speed),
            even=torch.zeros_like(goal_distance, dtype=torch.bool),
        )
