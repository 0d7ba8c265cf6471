"""
Pierson's arc: the shepherds stand around the flock and steer it like one unicycle.

A. Pierson and M. Schwager 2015, "Bio-inspired non-cooperative multi-robot herding". The flock here
is pushed with a force that does not depend on distance, so the arc's opening is chosen from the
normalised sum of pushes, and its radius from the flock's spread.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from shepherd_ros.config import Config, ConfigError, option
from shepherd_ros.controllers.controller import Controller, CONTROLLERS, Memory, places_on_arc
from shepherd_ros.controllers.pierson_compiled import pierson_act
from shepherd_ros.sim.compiled import compilable
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.tally import flock_spread
from shepherd_ros.sim.vectors import bearing, clip_norm, from_bearing, unit, wrap
import torch
from torch import Tensor


@dataclass(frozen=True)
class PiersonConfig(Config):
    """Options of the Pierson controller: choices, tuned once on the Strömbom flock."""

    lead: float = option(
        2.0, 'l [m]: the point steered lies so far ahead of the center', low=0.001
    )
    gain: float = option(0.05, 'k [1/s]: gain of the steered point toward the goal', low=0.0)
    max_turn_rate: float = option(0.5, 'the heading turns at most so fast [rad/s]', low=0.0)
    weakest_push: float = option(
        0.15, 'least share of the full push, a nearly closed ring', low=0.01, high=0.99
    )
    strongest_push: float = option(0.9, 'greatest share of the full push', low=0.01, high=0.99)
    spread_factor: float = option(3.0, 'kappa [-]: arc radius in flock spreads', low=0.0)
    min_radius: float = option(4.0, 'smallest arc radius [m]', low=0.0)
    max_radius: float = option(
        0.0,
        'largest arc radius [m]; 0: 3/4 of the range at which sheep notice, of r_s for Reynolds',
        low=0.0,
    )
    tracking_gain: float = option(
        0.0, 'K_d [1/s] of a shepherd toward its place; 0: 1/dt, at most 2', low=0.0
    )
    pace: str = option(
        'tracking',
        'speed of a shepherd: tracking, K_d times its distance to its place; constant, the top '
        'speed, also beside its place',
        choices=('tracking', 'constant'),
    )
    assignment: str = option(
        'sorted',
        'sorted: places by bearing, no crossings; fixed: place j for shepherd j',
        choices=('sorted', 'fixed'),
    )

    def __post_init__(self) -> None:
        """Check each field and the order of the limits."""
        super().__post_init__()
        for low, high in (('weakest_push', 'strongest_push'), ('min_radius', 'max_radius')):
            lower, upper = getattr(self, low), getattr(self, high)
            if lower > upper and upper > 0:
                raise ConfigError(f'{low} is {lower}: expected at most {high}, {upper}')


def push_fraction(opening: Tensor, team: Tensor) -> Tensor:
    """Return q(Delta) in [0, 1]: the push of an arc relative to that of a point; q(0) = 1."""
    half = opening / (2 * team - 2).clamp(min=1)
    below = team * torch.sin(half)
    return torch.where(half < 1e-4, 1.0, torch.sin(team * half) / below.clamp(min=1e-9))


def opening_for(fraction: Tensor, team: Tensor) -> Tensor:
    """Return the opening Delta [rad] with push_fraction() = fraction, by refining a grid."""
    low = torch.zeros_like(fraction)
    width = 2 * math.pi * (team - 1) / team
    grid = torch.linspace(0.0, 1.0, 33, dtype=fraction.dtype, device=fraction.device)
    for _ in range(5):  # 32^5 cells: finer than float32
        fractions = push_fraction(low[..., None] + width[..., None] * grid, team[..., None])
        cell = (fractions[..., 1:-1] >= fraction[..., None]).sum(dim=-1)  # q falls monotonically
        low = low + width * grid[cell]
        width = width / 32
    return low + width / 2


@CONTROLLERS.add
class PiersonController(Controller):
    """Drives from an arc around the flock; its memory is the heading of the flock."""

    name = 'pierson'
    config_type = PiersonConfig
    executable = 'pierson'
    label = 'Pierson'
    order = 11
    style = ('#0072B2', ':', '^')

    def begin(self, state: WorldState) -> Memory:
        """Return the first heading (...) rad: from the flock to the goal."""
        return {'heading': bearing(state.goal - state.center)}

    def act(self, state: WorldState, memory: Memory) -> tuple[Tensor, Memory]:
        """Return commands, (..., H, 2) m/s, and the next heading (...) rad."""
        config, world, heading = self.config, self.world, memory['heading']
        flock = world.flock
        max_radius = max(config.max_radius or 0.75 * flock.arc_range, config.min_radius)
        gain = config.tracking_gain or min(1 / world.dt, 2.0)
        drift = max(flock.speed, 1e-9)
        if compilable(state.sheep, state.shepherds, heading):
            velocity, heading = pierson_act(
                state, heading, config, max_radius, gain, drift, world.dt, world.shepherd_speed
            )
            return velocity, {'heading': heading}
        center = state.center
        forward = from_bearing(heading)
        ahead = center + config.lead * forward - state.goal  # p - g
        left = torch.stack([-forward[..., 1], forward[..., 0]], dim=-1)
        speed = -config.gain * (ahead * forward).sum(dim=-1)
        turn_rate = -config.gain / config.lead * (ahead * left).sum(dim=-1)
        turn_rate = turn_rate.clamp(-config.max_turn_rate, config.max_turn_rate)
        heading = wrap(heading + turn_rate * world.dt)

        team = state.team_size.to(heading.dtype)
        push = (speed / drift).clamp(config.weakest_push, config.strongest_push)
        opening = opening_for(push, team.clamp(min=2))
        spread = flock_spread(state)[0]
        radius = (config.spread_factor * spread).clamp(config.min_radius, max_radius)
        # one shepherd stands opposite to the way to the goal, at the same radius
        rear = torch.where(team == 1, bearing(state.goal - center), heading) + math.pi
        spacing = torch.where(team == 1, 0.0, opening / (team - 1).clamp(min=1))[..., None]
        if config.assignment == 'sorted':
            around = wrap(bearing(state.shepherds - center[..., None, :]) - rear[..., None])
            place = places_on_arc(around, spacing, state.shepherd_mask)
        else:
            index = torch.arange(state.shepherds.shape[-2], device=heading.device)
            place = (index - (team[..., None] - 1) / 2) * spacing
        place = rear[..., None] + place
        target = center[..., None, :] + radius[..., None, None] * from_bearing(place)
        offset = target - state.shepherds
        if config.pace == 'constant':
            velocity = world.shepherd_speed * unit(offset)
        else:
            velocity = clip_norm(gain * offset, world.shepherd_speed)
        return velocity * state.shepherd_mask[..., None], {'heading': heading}
