"""Places of a team on a circle, and the ways to them that do not cut through the flock."""

from __future__ import annotations

from dataclasses import dataclass
import math

from shepherd_ros.controllers.controller import places_on_arc
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import bearing, EPSILON, from_bearing, unit, wrap
import torch
from torch import Tensor

FULL_TURN = 2 * math.pi  # [rad]
FULL_SPEED = 10.0  # [m] displacements so long are driven at the top speed
NEARLY_ON_CIRCLE = 0.5  # [m] so near a circle, or half a smaller one, the path along it begins
PASSING_ANGLE = math.pi / 4  # [rad] from straight apart to past each other


def bearings_in_order(angle: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """
    Return bearings (..., H) in [0, 2 pi) rad in order, and the gap after each, around the circle.

    mask (..., H) says who is there; the others come last, at inf and with a gap of -inf.
    """
    count = mask.sum(dim=-1, keepdim=True)
    angle = torch.where(mask, torch.remainder(angle, FULL_TURN), torch.inf).sort(dim=-1).values
    index = torch.arange(angle.shape[-1], device=angle.device)
    following = torch.where(
        index == count - 1, angle[..., :1] + FULL_TURN, angle.roll(-1, dims=-1)
    )
    return angle, torch.where(index < count, following - angle, -torch.inf)


def middle_of_ring(angle: Tensor, mask: Tensor) -> Tensor:
    """
    Return the middle of places all around that are, in the mean, where shepherds are; (...) rad.

    angle (..., H) rad are the shepherds' bearings, mask (..., H) says who is there. It is their
    mean, read from the widest gap between them on; on a whole ring all gaps give the same places.
    """
    angle, gap = bearings_in_order(angle, mask)
    widest = gap.argmax(dim=-1, keepdim=True)
    index = torch.arange(angle.shape[-1], device=angle.device)
    angle = torch.where(gap > -torch.inf, angle + FULL_TURN * (index <= widest), 0.0)
    return wrap(angle.sum(dim=-1) / mask.sum(dim=-1).clamp(min=1))


def midway(angle: Tensor, mask: Tensor) -> Tensor:
    """
    Return the bearings (..., H) rad midway between the two neighbours of each on a circle.

    angle (..., H) rad are the bearings of all, mask (..., H) says who is there. Who has but one
    neighbour has it on both sides; who is alone stays.
    """
    ahead = torch.remainder(
        angle[..., None, :] - angle[..., :, None], FULL_TURN
    )  # from row to column
    other = mask[..., None, :] & ~torch.eye(angle.shape[-1], dtype=torch.bool, device=angle.device)
    gap_ahead = torch.where(other, ahead, FULL_TURN).amin(dim=-1)
    gap_behind = torch.where(other, FULL_TURN - ahead, FULL_TURN).amin(dim=-1)
    return angle + (gap_ahead - gap_behind) / 2


@dataclass(frozen=True)
class Formation:
    """Places for a team: on a circle, evenly apart; (..., 1) each."""

    about: Tensor  # the circle's middle, (..., 1, 2) m
    distance: Tensor  # its radius [m]
    middle: Tensor  # bearing of the middle of the places [rad]
    spacing: Tensor  # between them [rad]
    along: Tensor  # whether shepherds go along the circle, else round the flock
    pace: Tensor  # top speed on that path [m/s]
    even: Tensor  # whether each is midway between its neighbours, wherever the middle is

    def where(self, mask: Tensor, other: Formation) -> Formation:
        """Return this one where the mask (..., 1) is set, else the other."""
        pairs = {name: (getattr(self, name), getattr(other, name)) for name in vars(self)}
        about = torch.where(mask[..., None], *pairs.pop('about'))
        return Formation(about, **{name: torch.where(mask, *pair) for name, pair in pairs.items()})

    def places(self, state: WorldState) -> Tensor:
        """Return a bearing for each shepherd, (..., H) rad."""
        angle = bearing(state.shepherds - self.about)
        around = wrap(angle - self.middle)
        place = self.middle + places_on_arc(around, self.spacing, state.shepherd_mask)
        return torch.where(self.even, midway(angle, state.shepherd_mask), place)

    def displacement_along(self, state: WorldState, place: Tensor, gain: float) -> Tensor:
        """Return displacements to bearings (..., H) rad, along the circle; (..., H, 2) m."""
        out, stand = state.shepherds - self.about, self.distance
        distance = torch.linalg.vector_norm(out, dim=-1)
        angle = bearing(out)
        step = self.pace / gain  # [m] driven in a time constant of the gain
        nearer = (stand - distance).clamp(-step, step)
        near = torch.full_like(stand, NEARLY_ON_CIRCLE)
        outside = distance + nearer >= stand - torch.minimum(stand / 2, near)
        turn = wrap(place - angle).clamp(-step / stand, step / stand)
        turn = torch.where(outside, turn, 0.0)
        there = self.about + (distance + nearer)[..., None] * from_bearing(angle + turn)
        return there - state.shepherds


def detour(state: WorldState, target: Tensor, center: Tensor, clear: Tensor) -> Tensor:
    """Return displacements toward a target that go round the flock, (..., H, 2) m."""
    from_center = state.shepherds - center
    distance = torch.linalg.vector_norm(from_center, dim=-1)
    turn = wrap(bearing(target - center) - bearing(from_center))
    straight = target - state.shepherds
    # nearest point of the straight path to the center
    length = torch.linalg.vector_norm(straight, dim=-1).clamp(min=1e-6)
    along = (-(from_center * straight).sum(dim=-1) / length.square()).clamp(0.0, 1.0)
    nearest = torch.linalg.vector_norm(from_center + along[..., None] * straight, dim=-1)
    blocked = (nearest < torch.minimum(clear, distance) - 0.01) & (turn.abs() > 0.2)
    side = torch.where(turn >= 0, 1.0, -1.0) * (math.pi / 2)
    tangent = from_bearing(bearing(from_center) + side)
    outward = unit(from_center) * ((clear - distance).clamp(0.0, 1.0))[..., None]
    return torch.where(blocked[..., None], (tangent + outward) * FULL_SPEED, straight)


def separation(state: WorldState, reach: float) -> Tensor:
    """
    Return the push from others nearer than reach [m], (..., H, 2): 2 long from one at hand.

    It keeps to the right, so that two who want to go where the other is pass by each other.
    """
    offset = state.shepherds[..., :, None, :] - state.shepherds[..., None, :, :]
    distance = torch.linalg.vector_norm(offset, dim=-1)
    near = (1 - distance / max(reach, EPSILON)).clamp(min=0.0) * state.shepherd_mask[..., None, :]
    push = 2 * (unit(offset) * near[..., None]).sum(dim=-2)
    left = torch.stack([-push[..., 1], push[..., 0]], dim=-1)
    return math.cos(PASSING_ANGLE) * push + math.sin(PASSING_ANGLE) * left
