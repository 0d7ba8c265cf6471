"""
The reward, the same for every shepherd: the two terms of the paper (section 4), and others.

A term of its own needs one entry, REWARD_TERMS.add(RewardTerm(name, meaning, value)), and counts
where its weight is given, as an option of its name in RewardConfig.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

from shepherd_ros.config import option
from shepherd_ros.registry import Extended, Registry
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor

REWARD_TERMS: Registry[RewardTerm] = Registry('reward term')


@dataclass(frozen=True)
class RewardConfig(Extended):
    """Weights of the reward's terms."""

    registry: ClassVar = REWARD_TERMS
    occupancy: float = option(10.0, 'lambda_o [-]: weight of the sheep in the goal')
    shaping: float = option(-0.1, 'lambda_s [1/m]: weight of the distance of those outside')
    one_per_step: bool = option(
        False,
        'add the one of "one plus the distance" once per step (choice: once per sheep outside)',
    )


@dataclass(frozen=True)
class Step:
    """A step of worlds (...), and what terms share of it."""

    before: WorldState
    after: WorldState
    config: RewardConfig
    episode_steps: int

    @cached_property
    def gap(self) -> Tensor:
        """Return the distance of each sheep to the goal's rim, negative inside; (..., N) m."""
        return distance_to_rim(self.after)

    @cached_property
    def scale(self) -> Tensor:
        """Return the number of sheep times steps of an episode, (...)."""
        return self.after.flock_size * self.episode_steps


@dataclass(frozen=True)
class RewardTerm:
    """
    A part of the reward: value(step, weight) returns it for a step, (...).

    Without a weight a term is not computed, but for those of the paper.
    """

    name: str
    meaning: str
    value: Callable[[Step, float], Tensor]
    low: float | None = None  # of the weight
    high: float | None = None
    default: ClassVar[float] = 0.0


def distance_to_rim(state: WorldState) -> Tensor:
    """Return the distance of each sheep to the goal's rim, negative inside; -> (..., N) m."""
    to_goal = torch.linalg.vector_norm(state.sheep - state.goal[..., None, :], dim=-1)
    return to_goal - state.goal_radius[..., None]


def reward_terms(
    state: WorldState,
    config: RewardConfig,
    episode_steps: int,
    before: WorldState | None = None,
) -> dict[str, Tensor]:
    """
    Return the terms for the state after a step, (...) each; the reward is their sum.

    before is the state that the step began with, by default the same.
    """
    step = Step(state if before is None else before, state, config, episode_steps)
    weights = {'occupancy': config.occupancy, 'shaping': config.shaping} | dict(config.others)
    terms = REWARD_TERMS.loaded()
    return {name: terms[name].value(step, weight) for name, weight in weights.items()}


def _occupancy(step: Step, weight: float) -> Tensor:
    inside = (step.gap <= 0) & step.after.sheep_mask
    return weight * inside.sum(dim=-1) / step.scale


def _shaping(step: Step, weight: float) -> Tensor:
    outside = (step.gap > 0) & step.after.sheep_mask
    distance = (step.gap * outside).sum(dim=-1)
    ones = outside.any(dim=-1) if step.config.one_per_step else outside.sum(dim=-1)
    return weight * (ones + distance) / step.scale


for _term in (
    RewardTerm('occupancy', 'the sheep in the goal', _occupancy),
    RewardTerm('shaping', 'the distance of the sheep outside, and one for each', _shaping),
):
    REWARD_TERMS.add(_term)
