"""
Reynolds flock (boids): sheep that always move, keep apart, align and keep together.

C. W. Reynolds 1987, "Flocks, herds and schools", with fear of shepherds added. The acceleration is
cut, without which the flock does not travel together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from shepherd_ros.config import option
from shepherd_ros.sim.compiled import compilable
from shepherd_ros.sim.flocking.flock_model import FLOCK_MODELS, FlockConfig, FlockModel
from shepherd_ros.sim.flocking.reynolds_flock_compiled import reynolds_step
from shepherd_ros.sim.flocking.strombom_flock import offsets, StrombomFlock
from shepherd_ros.sim.fused import fused
from shepherd_ros.sim.rng import normal, Stream, uniform
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import clip_norm, EPSILON, from_bearing
import torch
from torch import Tensor

SOFT_LENGTH = 0.01  # length of a term [m, 1/m or 1] below which it counts in proportion


@dataclass(frozen=True)
class ReynoldsFlock(FlockConfig):
    """Parameters of the Reynolds flock: Table 1 of the paper, unless said otherwise."""

    restless: ClassVar[bool] = True
    checkpoint: ClassVar[str] = 'reynolds'

    view_range: float = option(7.5, 'R_n [m]: a sheep sees sheep and shepherds so near', low=0.0)
    separation: float = option(1.0, 'w_s [-]: weight of repulsion by sheep', low=0.0)
    alignment: float = option(7.5, 'w_v [-]: weight of matching the mean velocity', low=0.0)
    cohesion: float = option(1.0, 'w_c [-]: weight of attraction to the local center', low=0.0)
    fear: float = option(10.0, 'w_f [-]: weight of repulsion by shepherds', low=0.0)
    terms: str = option(
        'unit',
        'unit: terms are directions, as in the Strömbom flock; raw: as long as they come (choice)',
        choices=('unit', 'raw'),
    )
    max_acceleration: float = option(
        1 / 3, 'the sum of all terms is cut to this [m/s2] (choice: 1/3)', low=0.0
    )
    min_distance: float = option(
        0.1, 'distances in the repulsions count as at least this [m] (choice)', low=0.001
    )
    heading_spread: float = option(
        0.3, 'standard deviation of first headings around a common one [rad] (choice)', low=0.0
    )

    @property
    def notice_range(self) -> float:
        """Return R_n [m]."""
        return self.view_range

    @property
    def arc_range(self) -> float:
        """Return r_s of a Strömbom flock, for which Pierson's arc was tuned (choice) [m]."""
        return StrombomFlock().shepherd_range


def soft_unit(term: Tensor) -> Tensor:
    """Return unit vectors (..., 2); terms below SOFT_LENGTH count in proportion."""
    return term / torch.linalg.vector_norm(term, dim=-1, keepdim=True).clamp(min=SOFT_LENGTH)


def reynolds_flock_step(
    state: WorldState, config: ReynoldsFlock, dt: float
) -> tuple[Tensor, Tensor]:
    """Return sheep [m] and heading after dt, (..., N, 2) each; each sheep moves speed * dt."""
    if compilable(state.sheep, state.shepherds):
        return reynolds_step(state, config, dt)
    heading = steered(state.sheep, state, config, dt)
    return state.sheep + (config.speed * dt) * heading, heading


@fused
def steered(sheep: Tensor, state: WorldState, config: ReynoldsFlock, dt: float) -> Tensor:
    """Return the headings (..., N, 2) of sheep (..., N, 2) m after dt of the flock's forces."""
    velocity = state.heading * config.speed
    x, y = offsets(sheep, sheep)
    squared = x * x + y * y
    itself = torch.eye(sheep.shape[-2], dtype=torch.bool, device=sheep.device)
    visible = (squared < config.view_range**2) & state.sheep_mask[..., None, :] & ~itself
    weight = visible.to(sheep.dtype)
    count = weight.sum(dim=-1, keepdim=True)

    def repulsion(x: Tensor, y: Tensor, squared: Tensor, near: Tensor) -> Tensor:
        inverse = near / squared.clamp(min=config.min_distance**2)
        return torch.stack([(x * inverse).sum(dim=-1), (y * inverse).sum(dim=-1)], dim=-1)

    def mean_visible(x: Tensor, y: Tensor) -> Tensor:
        total = torch.stack([(weight * x).sum(dim=-1), (weight * y).sum(dim=-1)], dim=-1)
        return total / count.clamp(min=1)

    separation = repulsion(x, y, squared, visible)
    cohesion = -mean_visible(x, y)  # of offsets, which are exact where sheep are close
    mean_heading = mean_visible(*state.heading[..., None, :, :].unbind(dim=-1))
    alignment = torch.where(count > 0, mean_heading - state.heading, 0.0) * config.speed

    x, y = offsets(sheep, state.shepherds)
    squared = x * x + y * y
    noticed = (squared < config.view_range**2) & state.shepherd_mask[..., None, :]
    fear = repulsion(x, y, squared, noticed)
    if config.terms == 'unit':
        separation, cohesion, fear = soft_unit(separation), soft_unit(cohesion), soft_unit(fear)
        alignment = soft_unit(mean_heading) - soft_unit(state.heading) * (count > 0)
    acceleration = (
        config.separation * separation
        + config.alignment * alignment
        + config.cohesion * cohesion
        + config.fear * fear
    )
    velocity = velocity + clip_norm(acceleration, config.max_acceleration) * dt
    length = torch.linalg.vector_norm(velocity, dim=-1, keepdim=True)
    return torch.where(length < EPSILON, state.heading, velocity / length.clamp(min=EPSILON))


def _first_heading(seed: Tensor, n: int, config: ReynoldsFlock) -> Tensor:
    """Return one random heading per flock with a normal spread around it; -> (..., n, 2)."""
    start, index = torch.zeros_like(seed), torch.arange(n, device=seed.device)
    common = uniform(seed, start, Stream.HEADING, index[:1]) * (2 * torch.pi)
    return from_bearing(
        common + config.heading_spread * normal(seed, start, Stream.HEADING, index + 1)
    )


FLOCK_MODELS.add(FlockModel('reynolds', ReynoldsFlock, _first_heading, reynolds_flock_step))
