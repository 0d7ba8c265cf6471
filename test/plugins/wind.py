"""A plug-in: a parameter of the world, wind that moves all sheep."""

from __future__ import annotations

from dataclasses import replace

from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.world_parameters import WORLD_PARAMETERS, WorldParameter


def blown(before: WorldState, after: WorldState, value: float, dt: float) -> WorldState:
    """Return the state with sheep that drifted along x."""
    return replace(after, sheep=after.sheep + after.sheep.new_tensor([value * dt, 0.0]))


WORLD_PARAMETERS.add(
    WorldParameter('wind', 0.0, 'drift of all sheep along x [m/s]', blown, low=-1.0, high=1.0)
)
