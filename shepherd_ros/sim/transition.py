"""One step of the world."""

from __future__ import annotations

from dataclasses import replace

from shepherd_ros.sim.flocking import model_of
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import clip_norm
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor


def usable(command: Tensor) -> Tensor:
    """Return which commands are finite; (..., H, 2) m/s -> (..., H) bool."""
    return command.isfinite().all(dim=-1)


def step(state: WorldState, command: Tensor, config: WorldConfig) -> WorldState:
    """
    Return the world dt later: the shepherds move first, then all sheep at once.

    command (..., H, 2) m/s in the world frame is cut to the top speed; one with a NaN or an
    infinite part counts as zero. Shepherds are holonomic points, the plane has no walls (paper,
    section 3).
    """
    obeyed = (usable(command) & state.shepherd_mask)[..., None]
    velocity = clip_norm(torch.where(obeyed, command, 0.0), config.shepherd_speed)
    moved = replace(state, shepherds=state.shepherds + velocity * config.dt)
    sheep, heading = model_of(config.flock).step(moved, config.flock, config.dt)
    present = state.sheep_mask[..., None]
    return replace(
        moved,
        step=state.step + 1,
        sheep=torch.where(present, sheep, state.sheep),
        heading=torch.where(present, heading, state.heading),
    )
