"""
Parameters of the world besides those of WorldConfig, each with its law.

A parameter of your own is one entry, WORLD_PARAMETERS.add(WorldParameter(...)). It is then an
option of WorldConfig: of flock_sim, of training and, as world.<name>, of evaluate and the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from shepherd_ros.registry import Registry
from shepherd_ros.sim.state import WorldState


@dataclass(frozen=True)
class WorldParameter:
    """
    A named number with its law, which changes the steps of a world.

    apply(before, after, value, dt) -> state: the state at the end of a step of dt [s] that began
    with before and would have ended with after. Only values other than the default are applied.
    Absent agents may get any finite place.
    """

    name: str
    default: float
    meaning: str  # with its unit
    apply: Callable[[WorldState, WorldState, float, float], WorldState]
    low: float | None = None
    high: float | None = None


WORLD_PARAMETERS: Registry[WorldParameter] = Registry('world parameter')
