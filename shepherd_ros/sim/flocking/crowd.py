"""
Crowd: pedestrians that walk across a square, around each other and away from shepherds.

Social force model of D. Helbing and P. Molnar 1995, Phys. Rev. E 51:4282, in substeps where the
time step is long. A pose carries no speed: of the velocity, a pedestrian keeps from one step to
the next its direction, with the part of the preferred speed that this has toward its target.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from shepherd_ros.config import option
from shepherd_ros.sim.compiled import compilable
from shepherd_ros.sim.flocking.crowd_compiled import crowd_step_compiled
from shepherd_ros.sim.flocking.flock_model import FLOCK_MODELS, FlockConfig, FlockModel
from shepherd_ros.sim.limits import MAX_SHEEP
from shepherd_ros.sim.rng import direction, Stream, uniform
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import EPSILON, unit
import torch
from torch import Tensor

SUBSTEP = 0.1  # [s] at most


@dataclass(frozen=True)
class CrowdFlock(FlockConfig):
    """Parameters of the crowd; ranges and weights are choices, but for tau, A and B."""

    restless = True
    checkpoint = 'escort'

    speed: float = option(0.5, 'highest preferred speed of a pedestrian [m/s]', low=0.0)
    slowest: float = option(0.2, 'lowest preferred speed [m/s]', low=0.0)
    fastest: float = option(1.3, 'nobody is faster than this times its preferred speed', low=1.0)
    square: float = option(50.0, 'side of the square whose edges they walk between [m]', low=1.0)
    relaxation: float = option(0.5, 'tau [s]: time to reach the preferred velocity', low=0.01)
    body_radius: float = option(0.25, 'radius of a pedestrian [m]', low=0.0)
    repulsion: float = option(2.1, 'A [m/s2]: push of another pedestrian in contact', low=0.0)
    repulsion_length: float = option(0.3, 'B [m]: distance in which it falls to 1/e', low=0.01)
    pedestrian_range: float = option(5.0, 'pedestrians so near push each other [m]', low=0.0)
    escort_repulsion: float = option(4.0, 'A_e [m/s2]: push of a shepherd in contact', low=0.0)
    escort_length: float = option(1.0, 'B_e [m]: distance in which it falls to 1/e', low=0.01)
    escort_range: float = option(5.0, 'shepherds so near push [m]', low=0.0)

    @property
    def notice_range(self) -> float:
        """Return the range of the shepherds' push [m]."""
        return self.escort_range


def substeps(dt: float) -> int:
    """Return the number of substeps of a step of dt [s]."""
    return max(math.ceil(dt / SUBSTEP - 1e-9), 1)


def preferred_speed(seed: Tensor, n: int, config: CrowdFlock) -> Tensor:
    """Return the preferred speeds, (..., n) m/s in float32, the same in all steps."""
    index = 3 * torch.arange(n, device=seed.device)
    share = uniform(seed, torch.zeros_like(seed), Stream.PEDESTRIAN_SPEED, index)
    return config.slowest + (config.speed - config.slowest) * share


def targets(state: WorldState, config: CrowdFlock, dt: float) -> Tensor:
    """
    Return the points that pedestrians walk to, (..., N, 2) m.

    A point lies on an edge of the square; after the time that its preferred speed needs for the
    side of the square, at a random moment first, a pedestrian turns to one on the opposite edge.
    """
    n, seed, zero = state.sheep.shape[-2], state.seed, torch.zeros_like(state.seed)
    index = torch.arange(n, device=seed.device)
    phase = uniform(seed, zero, Stream.PEDESTRIAN_SPEED, 3 * index + 1, torch.float64)
    side = uniform(seed, zero, Stream.PEDESTRIAN_SPEED, 3 * index + 2, torch.float64)
    speed = preferred_speed(seed, n, config).double()
    crossings = state.step.double()[..., None] * dt * speed / config.square + phase
    crossing = crossings.floor().long()  # (..., N)
    edge = ((4 * side).long() + 2 * crossing) % 4
    key = crossing * MAX_SHEEP + index
    drawn = uniform(
        seed[..., None].expand(key.shape), key, Stream.PEDESTRIAN_TARGET, index[0], torch.float64
    )
    along, half = (drawn - 0.5) * config.square, config.square / 2
    across = torch.where(edge < 2, half, -half)
    vertical = edge % 2 == 0  # an edge at x = half or -half
    x, y = torch.where(vertical, across, along), torch.where(vertical, along, across)
    return torch.stack([x, y], dim=-1).to(state.sheep.dtype)


def social_push(
    points: Tensor,
    others: Tensor,
    mask: Tensor,
    strength: float,
    length: float,
    contact: float,
    reach: float,
) -> Tensor:
    """Return the push [m/s2] of others (..., K, 2) m, mask (..., K), on points (..., N, 2) m."""
    offset = points[..., :, None, :] - others[..., None, :, :]
    distance = torch.linalg.vector_norm(offset, dim=-1)
    near = (distance < reach) & (distance > EPSILON) & mask[..., None, :]
    size = strength * torch.exp((contact - distance) / length) / distance.clamp(min=EPSILON)
    return (torch.where(near, size, 0.0)[..., None] * offset).sum(dim=-2)


def crowd_step(state: WorldState, config: CrowdFlock, dt: float) -> tuple[Tensor, Tensor]:
    """Return sheep [m] and heading after dt, (..., N, 2) each."""
    n, target = state.sheep.shape[-2], targets(state, config, dt)
    preferred = preferred_speed(state.seed, n, config).to(state.sheep.dtype)
    if compilable(state.sheep, state.shepherds):
        return crowd_step_compiled(state, target, preferred, config, dt, substeps(dt))
    preferred, sheep, contact = preferred[..., None], state.sheep, 2 * config.body_radius
    forward = (state.heading * unit(target - sheep)).sum(dim=-1, keepdim=True).clamp(min=0)
    velocity, h = preferred * forward * state.heading, dt / substeps(dt)
    for _ in range(substeps(dt)):
        wanted = preferred * unit(target - sheep)
        acceleration = (
            (wanted - velocity) / config.relaxation
            + social_push(
                sheep, sheep, state.sheep_mask, config.repulsion, config.repulsion_length,
                contact, config.pedestrian_range,
            )
            + social_push(
                sheep, state.shepherds, state.shepherd_mask, config.escort_repulsion,
                config.escort_length, contact, config.escort_range,
            )
        )  # fmt: skip
        velocity = velocity + acceleration * h
        speed = torch.linalg.vector_norm(velocity, dim=-1, keepdim=True)
        velocity = velocity * (config.fastest * preferred / speed.clamp(min=EPSILON)).clamp(max=1)
        sheep = sheep + velocity * h
    speed = torch.linalg.vector_norm(velocity, dim=-1, keepdim=True)
    return sheep, torch.where(speed < EPSILON, state.heading, velocity / speed.clamp(min=EPSILON))


def random_headings(seed: Tensor, n: int, config: FlockConfig) -> Tensor:
    """Return independent random headings; (...) int64 -> (..., n, 2)."""
    index = torch.arange(n, device=seed.device)
    return direction(seed, torch.zeros_like(seed), Stream.HEADING, index)


FLOCK_MODELS.add(FlockModel('crowd', CrowdFlock, random_headings, crowd_step))
