"""Places of a team on a circle, and paths to them around the flock."""

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

    mask (..., H) marks the present ones; the others come last, at inf and with a gap of -inf.
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
    Return the bearing of the middle of a ring of places that fits the shepherds, (...) rad.

    angle (..., H) rad are their bearings, mask (..., H) marks the present ones. It is their mean,
    counted from the widest gap between them; on a whole ring all gaps give the same places.
    """
    angle, gap = bearings_in_order(angle, mask)
    widest = gap.argmax(dim=-1, keepdim=True)
    index = torch.arange(angle.shape[-1], device=angle.device)
    angle = torch.where(gap > -torch.inf, angle + FULL_TURN * (index <= widest), 0.0)
    return wrap(angle.sum(dim=-1) / mask.sum(dim=-1).clamp(min=1))


def midway(angle: Tensor, mask: Tensor) -> Tensor:
    """
    Return the bearings (..., H) rad midway between the two neighbours of each on a circle.

    angle (..., H) rad are the bearings of all, mask (..., H) marks the present ones. With one
    neighbour, it is on both sides; without any, the bearing stays.
    """
    angle_to = torch.remainder(
        angle[..., None, :] - angle[..., :, None], FULL_TURN
    )  # from row to column
    other = mask[..., None, :] & ~torch.eye(angle.shape[-1], dtype=torch.bool, device=angle.device)
    gap_ahead = torch.where(other, angle_to, FULL_TURN).amin(dim=-1)
    gap_behind = torch.where(other, FULL_TURN - angle_to, FULL_TURN).amin(dim=-1)
    return angle + (gap_ahead - gap_behind) / 2


@dataclass(frozen=True)
class Formation:
    """Places for a team on a circle, evenly spaced; (..., 1) each."""

    about: Tensor  # the circle's middle, (..., 1, 2) m
    distance: Tensor  # its radius [m]
    middle: Tensor  # bearing of the middle of the places [rad]
    spacing: Tensor  # between them [rad]
    along: Tensor  # whether shepherds go along the circle, else round the flock
    pace: Tensor  # top speed on that path [m/s]
    even: Tensor  # whether each is midway between its neighbours, wherever the middle is

    def where(self, mask: Tensor, other: Formation) -> Formation:
        """Return this formation where the mask (..., 1) is set, else the other."""
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
        offset, radius = state.shepherds - self.about, self.distance
        distance = torch.linalg.vector_norm(offset, dim=-1)
        angle = bearing(offset)
        step = self.pace / gain  # [m] driven in a time constant of the gain
        radial = (radius - distance).clamp(-step, step)
        margin = torch.full_like(radius, NEARLY_ON_CIRCLE)
        outside = distance + radial >= radius - torch.minimum(radius / 2, margin)
        turn = wrap(place - angle).clamp(-step / radius, step / radius)
        turn = torch.where(outside, turn, 0.0)
        point = self.about + (distance + radial)[..., None] * from_bearing(angle + turn)
        return point - state.shepherds


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
    Return the push from others nearer than reach [m], (..., H, 2); its length is 2 at contact.

    It is turned to the right, so that two shepherds that would swap places pass each other.
    """
    offset = state.shepherds[..., :, None, :] - state.shepherds[..., None, :, :]
    distance = torch.linalg.vector_norm(offset, dim=-1)
    near = (1 - distance / max(reach, EPSILON)).clamp(min=0.0) * state.shepherd_mask[..., None, :]
    push = 2 * (unit(offset) * near[..., None]).sum(dim=-2)
    left = torch.stack([-push[..., 1], push[..., 0]], dim=-1)
    return math.cos(PASSING_ANGLE) * push + math.sin(PASSING_ANGLE) * left
