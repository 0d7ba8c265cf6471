"""What a flock model consists of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from shepherd_ros.config import Config, option
from shepherd_ros.sim.state import WorldState
from torch import Tensor


@dataclass(frozen=True)
class FlockConfig(Config):
    """What every flock has."""

    speed: float = option(1 / 3, 'speed of a moving sheep, delta_a [m/s], Table 1', low=0.0)


@dataclass(frozen=True)
class FlockModel:
    """
    A named law of motion.

    first_heading(seed (...), n, config) -> (..., n, 2) unit vectors, the headings of a new flock;
    step(state, config, dt) -> sheep, heading after dt [s], each (..., N, 2), with the shepherds of
    the state already at their new places. Absent sheep may get any finite value.
    """

    name: str
    config: type[FlockConfig]
    first_heading: Callable[[Tensor, int, Any], Tensor]
    step: Callable[[WorldState, Any, float], tuple[Tensor, Tensor]]
