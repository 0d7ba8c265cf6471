"""The global reward, the same for every shepherd (paper, section 4)."""

from __future__ import annotations

from dataclasses import dataclass

from shepherd_ros.config import Config, option
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor


@dataclass(frozen=True)
class RewardConfig(Config):
    """Weights of the reward's terms."""

    occupancy: float = option(10.0, 'lambda_o [-]: weight of the sheep in the goal')
    shaping: float = option(-0.1, 'lambda_s [1/m]: weight of the distance of those outside')
    one_per_step: bool = option(
        False,
        'add the one of "one plus the distance" once per step (choice: once per sheep outside)',
    )


def distance_to_rim(state: WorldState) -> Tensor:
    """Return the distance of each sheep to the goal's rim, negative inside; -> (..., N) m."""
    to_goal = torch.linalg.vector_norm(state.sheep - state.goal[..., None, :], dim=-1)
    return to_goal - state.goal_radius[..., None]


def reward_terms(state: WorldState, config: RewardConfig, episode_steps: int) -> dict[str, Tensor]:
    """Return the terms for the state after a step, (...) each; the reward is their sum."""
    gap = distance_to_rim(state)
    outside = (gap > 0) & state.sheep_mask
    inside = (gap <= 0) & state.sheep_mask
    scale = state.flock_size * episode_steps
    distance = (gap * outside).sum(dim=-1)
    ones = outside.any(dim=-1) if config.one_per_step else outside.sum(dim=-1)
    return {
        'occupancy': config.occupancy * inside.sum(dim=-1) / scale,
        'shaping': config.shaping * (ones + distance) / scale,
    }
