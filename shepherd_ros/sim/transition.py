"""One step of the world."""

from __future__ import annotations

from dataclasses import replace

from shepherd_ros.sim import transition_compiled as compiled
from shepherd_ros.sim.compiled import compilable
from shepherd_ros.sim.flocking import model_of
from shepherd_ros.sim.goal_motion import moved_goal
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import clip_norm
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.sim.world_parameters import WORLD_PARAMETERS
import torch
from torch import Tensor


def finite_command(command: Tensor) -> Tensor:
    """Return the mask of finite commands; (..., H, 2) m/s -> (..., H) bool."""
    return command.isfinite().all(dim=-1)


def move(state: WorldState, command: Tensor, config: WorldConfig) -> Tensor:
    """Return the positions of the shepherds dt later, (..., H, 2) m."""
    if compilable(state.shepherds, command) and command.shape == state.shepherds.shape:
        return compiled.move_compiled(state, command, config.shepherd_speed, config.dt)
    valid = (finite_command(command) & state.shepherd_mask)[..., None]
    velocity = clip_norm(torch.where(valid, command, 0.0), config.shepherd_speed)
    return state.shepherds + velocity * config.dt


def step(state: WorldState, command: Tensor, config: WorldConfig) -> WorldState:
    """
    Return the world dt later: the shepherds move first, then the goal, then all sheep at once.

    command (..., H, 2) m/s in the world frame is cut to the top speed; one with a NaN or an
    infinite part counts as zero. Shepherds are holonomic points, the plane has no walls (paper,
    section 3).
    """
    moved = replace(state, shepherds=move(state, command, config), goal=moved_goal(state, config))
    sheep, heading = model_of(config.flock).step(moved, config.flock, config.dt)
    present = state.sheep_mask[..., None]
    after = replace(
        moved,
        step=state.step + 1,
        sheep=torch.where(present, sheep, state.sheep),
        heading=torch.where(present, heading, state.heading),
    )
    return apply_world_parameters(state, after, config) if config.others else after


def apply_world_parameters(
    before: WorldState, after: WorldState, config: WorldConfig
) -> WorldState:
    """Return the state after a step with the parameters of plug-ins applied."""
    for name, value in config.others:
        after = WORLD_PARAMETERS[name].apply(before, after, value, config.dt)
    sheep, shepherds = before.sheep_mask[..., None], before.shepherd_mask[..., None]
    return replace(
        after,
        sheep=torch.where(sheep, after.sheep, before.sheep),
        shepherds=torch.where(shepherds, after.shepherds, before.shepherds),
    )
