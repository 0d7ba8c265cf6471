"""
The reward, the same for every shepherd: the two terms of the paper (section 4), and others.

A term of its own needs one entry, REWARD_TERMS.add(RewardTerm(name, meaning, value)), and counts
where its weight is given, as an option of its name in RewardConfig.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from shepherd_ros.config import checked, Config, option, unknown_name
from shepherd_ros.registry import Registry
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
    others: tuple[tuple[str, float], ...] = ()  # names and weights, not 0, of terms of plug-ins

    def __post_init__(self) -> None:
        """Check every weight."""
        super().__post_init__()
        weights = []
        for name, value in sorted(self.others):
            if name not in self.added():
                raise unknown_name('RewardConfig field', name, [*super().to_dict(), *self.added()])
            term = REWARD_TERMS[name]
            weight = checked(name, value, 0.0, {'low': term.low, 'high': term.high})
            weights += [(name, weight)] if weight else []
        object.__setattr__(self, 'others', tuple(weights))

    def added(self) -> dict[str, tuple[float, str]]:
        """Return weight and meaning of each term of a plug-in."""
        own, weights = super().to_dict(), dict(self.others)
        return {
            name: (weights.get(name, 0.0), term.meaning)
            for name, term in REWARD_TERMS.items()
            if name not in own
        }

    def to_dict(self) -> dict[str, Any]:
        """Return plain data; of plug-ins only the weights that are not 0."""
        data = super().to_dict()
        return data | dict(data.pop('others'))

    def changes(self) -> dict[str, Any]:
        """Return plain data of what differs from the defaults."""
        found = super().changes()
        return found | dict(found.pop('others', ()))

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> RewardConfig:
        """Return the configuration that to_dict() gave, or raise ConfigError."""
        own = set(cls().to_dict())
        others = tuple((name, value) for name, value in data.items() if name not in own)
        known = {name: value for name, value in data.items() if name in own}
        return cls(**known, others=others)


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


REWARD_TERMS: Registry[RewardTerm] = Registry('reward term')


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
    return {name: REWARD_TERMS[name].value(step, weight) for name, weight in weights.items()}


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
