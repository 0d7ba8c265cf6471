"""Motion of the goal: straight to a destination, or in a circle around it."""

from __future__ import annotations

from typing import Any

from shepherd_ros.sim.rng import direction, Stream
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import EPSILON
import torch
from torch import Tensor

GOAL_PATHS = ('straight', 'circle')


def first_destination(goal: Tensor, seed: Tensor, config: Any) -> Tensor:
    """
    Return the destination of a goal (..., 2) m in a random direction, (..., 2) m.

    config is a WorldConfig, as below; a goal that stands is its own destination.
    """
    if config.goal_speed == 0:
        return goal
    index, zero = torch.arange(1, device=seed.device), torch.zeros_like(seed)
    course = direction(seed, zero, Stream.GOAL_COURSE, index, torch.float64)[..., 0, :]
    return goal + (config.goal_distance * course).to(goal.dtype)


def moved_goal(state: WorldState, config: Any) -> Tensor:
    """Return the goal dt later, (..., 2) m; a straight path ends exactly at the destination."""
    if config.goal_speed == 0:
        return state.goal
    stride = config.goal_speed * config.dt  # m
    offset = state.destination - state.goal
    distance = torch.hypot(offset[..., :1], offset[..., 1:])
    if config.goal_path == 'straight':
        near = distance <= stride
        return torch.where(
            near, state.destination, state.goal + offset * (stride / distance.clamp(min=EPSILON))
        )
    angle = torch.where(distance > EPSILON, stride / distance.clamp(min=EPSILON), 0.0)
    cos, sin = angle.cos(), angle.sin()
    x, y = -offset[..., :1], -offset[..., 1:]
    return state.destination + torch.cat([x * cos - y * sin, x * sin + y * cos], dim=-1)
