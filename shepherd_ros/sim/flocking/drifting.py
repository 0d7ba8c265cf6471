"""
Drifting: obstacles that move along straight lines, reflect at the walls and react to nobody.

As the moving obstacles of H. L. Chiang et al., WAFR 2014. The speed is drawn anew each second.
"""

from __future__ import annotations

from dataclasses import dataclass

from shepherd_ros.config import option
from shepherd_ros.sim.flocking.crowd import random_headings
from shepherd_ros.sim.flocking.flock_model import FLOCK_MODELS, FlockConfig, FlockModel
from shepherd_ros.sim.rng import Stream, uniform
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor


@dataclass(frozen=True)
class DriftingFlock(FlockConfig):
    """Parameters of drifting obstacles (choices)."""

    restless = True
    checkpoint = 'escort'

    speed: float = option(0.5, 'highest speed [m/s]', low=0.0)
    slowest: float = option(0.2, 'lowest speed [m/s]', low=0.0)
    square: float = option(50.0, 'side of the square whose walls reflect [m]', low=1.0)

    @property
    def notice_range(self) -> float:
        """Return 0: shepherds are not noticed [m]."""
        return 0.0


def drifting_step(state: WorldState, config: DriftingFlock, dt: float) -> tuple[Tensor, Tensor]:
    """Return sheep [m] and heading after dt, (..., N, 2) each."""
    index = torch.arange(state.sheep.shape[-2], device=state.sheep.device)
    second = (state.step.double() * dt).floor().long()
    share = uniform(state.seed, second, Stream.PEDESTRIAN_SPEED, index, state.sheep.dtype)
    speed = config.slowest + (config.speed - config.slowest) * share
    sheep, half = state.sheep + dt * speed[..., None] * state.heading, config.square / 2
    # an obstacle that started behind a wall comes back in its own time
    outward = (sheep.abs() > half) & (sheep * state.heading > 0)
    back = torch.where(state.sheep.abs() > half, state.sheep, sheep.sign() * 2 * half - sheep)
    return (
        torch.where(outward, back, sheep),
        torch.where(outward, -state.heading, state.heading),
    )


FLOCK_MODELS.add(FlockModel('drifting', DriftingFlock, random_headings, drifting_step))
