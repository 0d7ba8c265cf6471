"""
Strömbom's collecting and driving, for several shepherds, with arcs and wide detours.

Roles and positions: Strömbom et al. 2014, J. R. Soc. Interface 11:20140719. Several shepherds in
an arc around the flock and detours that do not disturb it: El-Fiqi et al. 2020, IEEE Access
8:214658.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from shepherd_ros.config import Config, option
from shepherd_ros.controllers.controller import Controller, CONTROLLERS, Memory, places_on_arc
from shepherd_ros.controllers.strombom_compiled import strombom_act
from shepherd_ros.sim.compiled import compilable
from shepherd_ros.sim.rng import direction, Stream
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import bearing, from_bearing, unit, wrap
import torch
from torch import Tensor


@dataclass(frozen=True)
class StrombomConfig(Config):
    """Options of the Strömbom controller; all its places are multiples of a range r."""

    interaction_range: float = option(
        0.0, "r [m]; 0: the flock's own range of repulsion, 1 m if it has none", low=0.0
    )
    position_law: str = option(
        'strombom',
        'strombom: drive r sqrt(N) behind, collect r behind, together within r N^(2/3); '
        'elfiqi: standoff behind a flock of r sqrt(2 N), standoff behind a sheep',
        choices=('strombom', 'elfiqi'),
    )
    standoff: float = option(4.0, 'distance kept by position law elfiqi, R2 [m]', low=0.0)
    arc_margin: float = option(
        0.0, 'a detour keeps so far outside the radius of the flock [m]; 0: 3 r', low=0.0
    )
    arc: str = option(
        'farthest',
        'radius of the flock that a detour goes round: farthest sheep, or rms of all distances '
        'from the center, which perception noise widens less',
        choices=('farthest', 'rms'),
    )
    arc_tolerance: float = option(
        0.2, 'no detour once the target is within this angle about the flock [rad]', low=0.0
    )
    wing_spacing: float = option(
        0.0, 'angle between neighbours on the driving arc [rad]; 0: pi / (2 M)', low=0.0
    )
    noise: float = option(0.3, 'e [-]: weight of a random direction, each step', low=0.0)
    stop_range: float = option(
        3.0, 'stand still while any sheep is within this many r; 0: never', low=0.0
    )
    stop_distance: float = option(
        0.0, 'stand still while any sheep is within this distance [m]; 0: stop_range r', low=0.0
    )


@CONTROLLERS.add
class StrombomController(Controller):
    """Collects the farthest sheep while the flock is scattered, else drives it."""

    name = 'strombom'
    config_type = StrombomConfig
    executable = 'strombom'
    label = 'Strömbom'
    order = 10
    style = ('#D55E00', '--', 's')

    @property
    def interaction_range(self) -> float:
        """Return r in metres."""
        return float(self.config.interaction_range or self.world.flock.repulsion_range)

    @property
    def stop_distance(self) -> float:
        """Return the distance to a sheep within which a shepherd stands still [m]."""
        return self.config.stop_distance or self.config.stop_range * self.interaction_range

    def act(self, state: WorldState, memory: Memory) -> tuple[Tensor, Memory]:
        """Return commands, (..., H, 2) m/s, and memory, which stays empty."""
        if compilable(state.sheep, state.shepherds):
            r, stop, world = self.interaction_range, self.stop_distance, self.world
            velocity = strombom_act(state, self.config, r, stop, world.dt, world.shepherd_speed)
            return velocity, memory
        center = state.center
        distance = torch.linalg.vector_norm(state.sheep - center[..., None, :], dim=-1)
        distance = distance.masked_fill(~state.sheep_mask, 0.0)
        target = self._targets(state, center, distance)
        radius = distance.amax(dim=-1)
        if self.config.arc == 'rms':
            size = state.flock_size.to(distance.dtype)
            radius = ((distance * distance).sum(dim=-1) / size).sqrt()
        velocity = self._approach(state, center, radius, target)
        return velocity * state.shepherd_mask[..., None], memory

    def _targets(self, state: WorldState, center: Tensor, distance: Tensor) -> Tensor:
        """Return the place of each shepherd, (..., H, 2) m: behind a stray or on the arc."""
        r, n = self.interaction_range, state.flock_size.to(distance.dtype)
        if self.config.position_law == 'strombom':
            max_spread, behind, collect = r * n ** (2 / 3), r * n.sqrt(), r
        else:
            max_spread = r * (2 * n).sqrt()
            behind, collect = max_spread + self.config.standoff, self.config.standoff

        shepherds, free = state.shepherds, state.shepherd_mask
        index = torch.arange(shepherds.shape[-2], device=shepherds.device)
        farthest = distance.topk(min(shepherds.shape[-2], distance.shape[-1]), dim=-1)
        stray = farthest.values > max_spread[..., None]  # (..., K), far to near
        target = torch.zeros_like(shepherds)
        for k in range(stray.shape[-1] if bool(stray.any()) else 0):
            index_of_sheep = farthest.indices[..., k, None, None].expand(
                *state.sheep.shape[:-2], 1, 2
            )
            sheep = state.sheep.gather(-2, index_of_sheep)
            shepherd_distance = torch.linalg.vector_norm(shepherds - sheep, dim=-1).masked_fill(
                ~free, torch.inf
            )
            nearest = index == shepherd_distance.argmin(dim=-1, keepdim=True)
            assigned = nearest & free & stray[..., k, None]
            behind_stray = sheep + collect * unit(sheep - center[..., None, :])
            target = torch.where(assigned[..., None], behind_stray, target)
            free = free & ~assigned

        rear = bearing(center - state.goal)[..., None]
        around = wrap(bearing(shepherds - center[..., None, :]) - rear)
        team = state.team_size[..., None]
        spacing = (
            math.pi / (2 * team)
            if self.config.wing_spacing == 0
            else (torch.full_like(rear, self.config.wing_spacing))
        )
        slot = rear + places_on_arc(around, spacing, free)
        driving = center[..., None, :] + behind[..., None, None] * from_bearing(slot)
        return torch.where(free[..., None], driving, target)

    def _approach(
        self, state: WorldState, center: Tensor, radius: Tensor, target: Tensor
    ) -> Tensor:
        """Return velocities (..., H, 2) m/s to the targets, around the flock if it is between."""
        config, dt, top = self.config, self.world.dt, self.world.shepherd_speed
        r, shepherds, center = self.interaction_range, state.shepherds, center[..., None, :]
        margin = config.arc_margin or 3 * r
        radius = (radius + margin)[..., None]  # (..., 1)
        to_target = target - shepherds
        course = unit(to_target)
        speed = (torch.linalg.vector_norm(to_target, dim=-1) / dt).clamp(max=top)

        offset = shepherds - center
        d = torch.linalg.vector_norm(offset, dim=-1)
        target_bearing = bearing(target - center)
        turn = wrap(target_bearing - bearing(offset))
        next_offset = offset + speed[..., None] * dt * course
        blocked = torch.linalg.vector_norm(next_offset, dim=-1) < radius
        detour = (turn.abs() > config.arc_tolerance) & blocked

        stride = top * dt
        outward = unit(offset)
        tangent = torch.stack([-outward[..., 1], outward[..., 0]], dim=-1)
        tangent = tangent * torch.where(turn < 0, -1.0, 1.0)[..., None]
        spiral = unit(tangent + ((radius - d) / max(stride, 1e-9))[..., None] * outward)
        # on the arc: the chord of one stride that ends on the circle, on the side of the target
        cosine = (d * d + stride**2 - radius**2) / (2 * d * stride).clamp(min=1e-9)
        cosine = cosine.clamp(-1.0, 1.0)[..., None]
        chord = -outward * cosine + tangent * (1 - cosine * cosine).sqrt()
        on_arc = torch.where((d < radius - stride)[..., None], spiral, chord)
        course = torch.where(detour[..., None], on_arc, course)
        speed = torch.where(detour, torch.full_like(speed, top), speed)

        if config.noise > 0:
            index = torch.arange(shepherds.shape[-2], device=shepherds.device)
            random = direction(state.seed, state.step, Stream.CONTROL, index, course.dtype)
            course = unit(course + config.noise * random)
        sheep_distance = torch.linalg.vector_norm(
            shepherds[..., :, None, :] - state.sheep[..., None, :, :], dim=-1
        ).masked_fill(~state.sheep_mask[..., None, :], torch.inf)
        speed = speed.masked_fill(sheep_distance.amin(dim=-1) < self.stop_distance, 0.0)
        return speed[..., None] * course
