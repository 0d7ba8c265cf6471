"""
The drover, a heuristic of this project: drives from far behind, lets go when the flock is home.

Pushes do not grow with nearness in the Strömbom flock, and sheep rest while nobody is near. So the
team stands on an arc behind the flock, seen from the goal, as far as it can and still be noticed;
it need not follow the flock, only turn about the goal. When every sheep is inside, it goes out of
their sight onto a ring around them. Sheep that never rest are driven from near and with haste, and
the ring is so narrow that they are turned back wherever they go. One or two shepherds cannot
close it: they run around such a flock and only ever touch its rim, so that it turns to and fro
over the goal.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from shepherd_ros.config import Config, option
from shepherd_ros.controllers.base import Controller, Memory, places_on_arc
from shepherd_ros.sim.flocking.reynolds import ReynoldsFlock
from shepherd_ros.sim.flocking.strombom import StrombomFlock
from shepherd_ros.sim.reward import distance_to_rim
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import bearing, clip_norm, from_bearing, masked_mean, unit, wrap
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor

FULL_SPEED = 10.0  # [m] a way so long is gone at the top speed
FRONT = 1.0  # [rad] a stray so near the bearing of a place on the ring is pushed back from there
WHOLE = 2 * math.pi  # [rad]
CROSSING = 0.75  # [goal radii] a flock so near the middle of the goal is turned
NEARLY_ON_RING = 0.5  # [m] so near a ring, or half a smaller one, the way along it begins


@dataclass(frozen=True)
class DroverConfig(Config):
    """Options of the drover; all are choices."""

    notice: float = option(
        0.0, 'sheep notice shepherds so near [m]; 0: as the flock of the world', low=0.0
    )
    stand_off: float = option(
        0.0, 'least distance to the flock while driving [m]; 0: as suits the flock', low=0.0
    )
    spacing: float = option(0.25, 'angle between neighbours on the arc [rad]', low=0.0)
    reach: float = option(
        0.0,
        'sheep so far from the middle notice the ring, in goal radii, negative: all inside notice '
        'it; 0: as suits the flock',
        low=-1.0,
        high=1.0,
    )
    gain: float = option(
        0.0,
        'speed over the distance to a place, K_d [1/s]; 0: as suits the flock',
        low=0.0,
    )
    patience: float = option(
        0.5, 'a team of one or two turns to strays so far outside [m]', low=0.0
    )
    arrived: float = option(0.8, 'share of the flock that has to be inside', low=0.0, high=1.0)
    lost: float = option(0.5, 'a smaller share inside is driven home again', low=0.0, high=1.0)
    touch: float = option(
        0.8, 'one or two touch a flock that never rests by so much of its view [m]', low=0.0
    )
    touch_from: float = option(
        1.5, 'they do while its middle is so near the goal [goal radii]', low=0.0
    )
    touch_turn: float = option(
        1.0, 'and turn it so far from the way to the goal, in the goal itself [rad]', low=0.0
    )
    touch_spacing: float = option(1.0, 'angle between two who do [rad]', low=0.0)


@dataclass(frozen=True)
class Manner:
    """How a flock is driven: the options of the same names."""

    stand_off: float  # [m]
    reach: float  # [goal radii]
    gain: float  # [1/s]


GENTLE = Manner(4.0, 0.45, 0.5)  # for sheep that rest when nobody is near; easy to learn
QUICK = Manner(2.0, -0.25, 2.0)  # for sheep that never rest, by a team that can close a ring
FEW = Manner(4.0, 0.0, 0.5)  # the same by one or two, who have no ring
RING = 3  # so many shepherds close a ring


def manner_for(world: WorldConfig, team: Tensor, config: DroverConfig) -> tuple[Tensor, ...]:
    """Return stand_off [m], reach [goal radii] and gain [1/s] for teams of a size, (...) each."""
    restless = isinstance(world.flock, ReynoldsFlock)
    many, few = (QUICK, FEW) if restless else (GENTLE, GENTLE)
    return tuple(
        torch.where(
            team >= RING,
            getattr(config, name) or getattr(many, name),
            getattr(config, name) or getattr(few, name),
        )
        for name in ('stand_off', 'reach', 'gain')
    )


def notice_range(world: WorldConfig) -> float:
    """Return how near a shepherd has to be for a sheep to react [m]."""
    flock = world.flock
    if isinstance(flock, StrombomFlock):
        return flock.shepherd_range
    return flock.view_range if isinstance(flock, ReynoldsFlock) else 10.0


def middle_of_ring(angle: Tensor, mask: Tensor) -> Tensor:
    """
    Return the middle of places all around that are, in the mean, where shepherds are; (...) rad.

    angle (..., H) rad are the shepherds' bearings, mask (..., H) says who is there. It is their
    mean, read from the widest gap between them on; on a whole ring all gaps give the same places.
    """
    count = mask.sum(dim=-1, keepdim=True)
    angle = torch.where(mask, torch.remainder(angle, WHOLE), torch.inf).sort(dim=-1).values
    index = torch.arange(angle.shape[-1], device=angle.device)
    following = torch.where(index == count - 1, angle[..., :1] + WHOLE, angle.roll(-1, dims=-1))
    gap = torch.where(index < count, following - angle, -torch.inf)
    widest = gap.argmax(dim=-1, keepdim=True)
    angle = torch.where(index < count, angle + WHOLE * (index <= widest), 0.0)
    return wrap(angle.sum(dim=-1) / count[..., 0].clamp(min=1))


class DroverController(Controller):
    """Drives until all sheep are inside, then lets go until one is outside again."""

    name = 'drover'
    config_type = DroverConfig

    def begin(self, seen: WorldState) -> Memory:
        """Return the first phase: driving."""
        zero = torch.zeros_like(seen.goal_radius)
        return {'home': zero.bool(), 'ring': zero}

    def act(self, seen: WorldState, memory: Memory) -> tuple[Tensor, Memory]:
        """Return commands (..., H, 2) m/s and memory."""
        config: DroverConfig = self.config
        goal, center = seen.goal[..., None, :], seen.center[..., None, :]  # (..., 1, 2) m
        radius = seen.goal_radius[..., None]
        notice = config.notice or notice_range(self.world)
        team = seen.team_size[..., None]
        stand_off, reach, gain = manner_for(self.world, team, config)  # (..., 1)
        behind = bearing(center - goal)  # (..., 1) rad
        away = torch.linalg.vector_norm(center - goal, dim=-1)
        far = torch.linalg.vector_norm(seen.sheep - center, dim=-1) * seen.sheep_mask
        far = far.amax(dim=-1, keepdim=True)

        # where to stand, (..., 1) each: around what, how far off, in which direction, how apart
        few = (team < RING) & isinstance(self.world.flock, ReynoldsFlock)
        touching = few & (away < config.touch_from * radius)
        ring, home = self._ring(seen, memory, behind)
        home = home[..., None] & ~few
        clear = far + torch.where(touching, notice - config.touch, stand_off)
        about = torch.where(touching[..., None], center, goal)
        stand = torch.where(touching, clear, (away + clear).clamp(min=notice))
        stand = torch.where(home, notice + reach * radius, stand)
        middle = torch.where(touching, self._aside(seen, behind, away), behind)
        middle = torch.where(home, ring[..., None], middle)
        spacing = torch.where(touching, config.touch_spacing, config.spacing)
        spacing = torch.where(home, WHOLE / team, spacing)

        around = wrap(bearing(seen.shepherds - about) - middle)
        place = middle + places_on_arc(around, spacing, seen.shepherd_mask)
        target = about + stand[..., None] * from_bearing(place)
        # on a circle the way is along it, as a straight one would cut through the flock
        along = self._along_circle(seen, about, place, stand)
        way = self._round(seen, target, center, clear)
        way = torch.where((home | touching)[..., None], along, way)
        gain = torch.where(touching, QUICK.gain, gain)
        velocity = clip_norm(way * gain[..., None], self.world.shepherd_speed)
        return velocity, {'home': home[..., 0], 'ring': ring}

    def _ring(self, seen: WorldState, memory: Memory, behind: Tensor) -> tuple[Tensor, Tensor]:
        """Return the middle of a ring's places, (...) rad, and whether the flock is home."""
        config: DroverConfig = self.config
        gap = torch.where(seen.sheep_mask, distance_to_rim(seen), -torch.inf)  # (..., N) m
        share = (gap <= 0).sum(dim=-1) / gap.shape[-1]
        home = share >= torch.where(memory['home'], config.lost, config.arrived)
        ring = torch.where(home & ~memory['home'], behind[..., 0], memory['ring'])
        ring = self._turned_to_strays(seen, gap, ring, WHOLE / seen.team_size)
        # that of three and more is where they are, so that who sees the team needs no memory
        angle = bearing(seen.shepherds - seen.goal[..., None, :])
        team_ring = middle_of_ring(angle, seen.shepherd_mask)
        return torch.where(seen.team_size >= RING, team_ring, ring), home

    def _aside(self, seen: WorldState, behind: Tensor, away: Tensor) -> Tensor:
        """Return where to stand to turn a flock on its way over the goal; (..., 1) rad."""
        heading = bearing(masked_mean(seen.heading, seen.sheep_mask))[..., None]
        side = torch.where(torch.sin(heading - behind) >= 0, 1.0, -1.0)
        crossing = 1 - away / (CROSSING * seen.goal_radius[..., None])
        return behind - side * self.config.touch_turn * crossing.clamp(min=0.0)

    def _turned_to_strays(
        self, seen: WorldState, gap: Tensor, ring: Tensor, spacing: Tensor
    ) -> Tensor:
        """
        Return the direction of the ring's middle, (...) rad, so that some place is behind strays.

        The ring stays while a stray is in front of one of its places, else it turns to the
        farthest.
        """
        edge = ring - (seen.team_size - 1) / 2 * spacing  # bearing of one of the places
        stray = bearing(seen.sheep - seen.goal[..., None, :])  # (..., N)
        off = torch.remainder(stray - edge[..., None], spacing[..., None])
        off = torch.minimum(off, spacing[..., None] - off)
        outside = gap > self.config.patience
        watched = (outside & (off < FRONT)).any(dim=-1) | ~outside.any(dim=-1)
        farthest = stray.gather(-1, gap.argmax(dim=-1, keepdim=True))[..., 0]
        turned = farthest + (seen.team_size - 1) / 2 * spacing
        return torch.where(watched, ring, turned)

    def _along_circle(
        self, seen: WorldState, about: Tensor, place: Tensor, stand: Tensor
    ) -> Tensor:
        """Return the way to places on a circle about a point, along it; (..., H, 2) m."""
        out = seen.shepherds - about
        distance = torch.linalg.vector_norm(out, dim=-1)
        angle = bearing(out)
        turn = wrap(place - angle)
        step = self.world.shepherd_speed * self.world.dt / stand
        near = torch.full_like(stand, NEARLY_ON_RING)
        nearer = (stand - distance).clamp(-step * stand, step * stand)
        outside = distance + nearer >= stand - torch.minimum(stand / 2, near)
        turn = torch.where(outside, turn.clamp(-step, step), 0.0)
        there = about + (distance + nearer)[..., None] * from_bearing(angle + turn)
        return there - seen.shepherds

    def _round(self, seen: WorldState, target: Tensor, center: Tensor, clear: Tensor) -> Tensor:
        """Return the way to take to a target, (..., H, 2) m, not through the flock."""
        from_center = seen.shepherds - center
        distance = torch.linalg.vector_norm(from_center, dim=-1)
        turn = wrap(bearing(target - center) - bearing(from_center))
        straight = target - seen.shepherds
        # nearest point of the straight way to the center
        length = torch.linalg.vector_norm(straight, dim=-1).clamp(min=1e-6)
        along = (-(from_center * straight).sum(dim=-1) / length.square()).clamp(0.0, 1.0)
        nearest = torch.linalg.vector_norm(from_center + along[..., None] * straight, dim=-1)
        blocked = (nearest < torch.minimum(clear, distance) - 0.01) & (turn.abs() > 0.2)
        side = torch.where(turn >= 0, 1.0, -1.0) * (math.pi / 2)
        tangent = from_bearing(bearing(from_center) + side)
        outward = unit(from_center) * ((clear - distance).clamp(0.0, 1.0))[..., None]
        return torch.where(blocked[..., None], (tangent + outward) * FULL_SPEED, straight)


CONTROLLER = DroverController
