"""A plug-in: a flock model, sheep that stand until a shepherd is near."""

from __future__ import annotations

from dataclasses import dataclass

from shepherd_ros.config import option
from shepherd_ros.sim.flocking.flock_model import FLOCK_MODELS, FlockConfig, FlockModel
from shepherd_ros.sim.rng import direction, Stream
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import unit
import torch
from torch import Tensor


@dataclass(frozen=True)
class LazyFlock(FlockConfig):
    """A flock of sheep that know each other not."""

    fear_range: float = option(6.0, 'a sheep runs from shepherds so near [m]', low=0.0)

    @property
    def notice_range(self) -> float:
        """Return how near a shepherd has to be for a sheep to react [m]."""
        return self.fear_range


def step(state: WorldState, config: LazyFlock, dt: float) -> tuple[Tensor, Tensor]:
    """Return sheep and heading after dt."""
    away = state.sheep[..., :, None, :] - state.shepherds[..., None, :, :]
    near = torch.linalg.vector_norm(away, dim=-1) < config.fear_range
    near = (near & state.shepherd_mask[..., None, :])[..., None]
    fleeing = unit((unit(away) * near).sum(dim=-2))
    heading = torch.where(near.any(dim=-2), fleeing, state.heading)
    return state.sheep + fleeing * config.speed * dt, heading


def first_heading(seed: Tensor, n: int, config: LazyFlock) -> Tensor:
    """Return independent random headings; (...) int64 -> (..., n, 2)."""
    index = torch.arange(n, device=seed.device)
    return direction(seed, torch.zeros_like(seed), Stream.HEADING, index)


FLOCK_MODELS.add(FlockModel('lazy', LazyFlock, first_heading, step))
