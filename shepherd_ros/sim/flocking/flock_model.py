"""Base class, parts and registry of flock models."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from shepherd_ros.config import Config, option
from shepherd_ros.registry import Registry
from shepherd_ros.sim.state import WorldState
from torch import Tensor


@dataclass(frozen=True)
class FlockConfig(Config):
    """Configuration of any flock: speed, and properties for controllers and experiments."""

    restless: ClassVar[bool] = False  # whether sheep move while no shepherd is near
    checkpoint: ClassVar[str] = 'general'  # the shipped one that was trained for it
    repulsion_option: ClassVar[str] = ''  # rho_a, which experiments sweep; empty: it has none

    speed: float = option(1 / 3, 'speed of a moving sheep, delta_a [m/s], Table 1', low=0.0)

    @property
    def notice_range(self) -> float:
        """Return the distance within which sheep react to a shepherd [m]."""
        return 10.0

    @property
    def arc_range(self) -> float:
        """Return the range that scales Pierson's widest arc [m]."""
        return self.notice_range

    @property
    def repulsion_range(self) -> float:
        """Return the range of repulsion between sheep [m], 1 without repulsion."""
        return 1.0


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


FLOCK_MODELS: Registry[FlockModel] = Registry('flock')
