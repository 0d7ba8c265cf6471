"""
The reward, the same for every shepherd: the two terms of the paper (section 4), and others.

A term of its own needs one entry, REWARD_TERMS.add(RewardTerm(name, meaning, value)), and counts
where its weight is given, as an option of its name in RewardConfig.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from shepherd_ros.config import option
from shepherd_ros.registry import Extended, Registry
from shepherd_ros.sim.state import WorldState
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

    def weight(self, name: str) -> float:
        """Return the weight of a term by its name."""
        if name in self._own():
            return float(getattr(self, name))
        return float(dict(self.others).get(name, REWARD_TERMS.loaded()[name].default))


class Step(NamedTuple):
    """A step of worlds (...), with the values that reward terms share."""

    before: WorldState
    after: WorldState
    config: RewardConfig
    episode_steps: int
    scale: Tensor  # (...): number of sheep times steps of an episode


@dataclass(frozen=True)
class RewardTerm:
    """
    A part of the reward: value(step, weight) returns it for a step, (...).

    Without a weight a term is not computed, but for those of the task.
    """

    name: str
    meaning: str
    value: Callable[[Step, float], Tensor]
    low: float | None = None  # of the weight
    high: float | None = None
    default: float = 0.0


def reward_terms(
    state: WorldState,
    config: RewardConfig,
    episode_steps: int,
    before: WorldState | None = None,
    names: tuple[str, ...] = ('occupancy', 'shaping'),
) -> dict[str, Tensor]:
    """
    Return the terms for the state after a step, (...) each; the reward is their sum.

    before is the state that the step began with, by default the same; names are those of the
    task's terms, by default the paper's.
    """
    scale = state.flock_size * episode_steps
    step = Step(state if before is None else before, state, config, episode_steps, scale)
    terms = REWARD_TERMS.loaded()
    weights = {name: config.weight(name) for name in names} | dict(config.others)
    return {name: terms[name].value(step, weight) for name, weight in weights.items()}


def _occupancy(step: Step, weight: float) -> Tensor:
    return weight * step.after.inside.sum(dim=-1) / step.scale


def _shaping(step: Step, weight: float) -> Tensor:
    gap = step.after.gap
    outside = (gap > 0) & step.after.sheep_mask
    distance = (gap * outside).sum(dim=-1)
    ones = outside.any(dim=-1) if step.config.one_per_step else outside.sum(dim=-1)
    return weight * (ones + distance) / step.scale


for _term in (
    RewardTerm('occupancy', 'the sheep in the goal', _occupancy),
    RewardTerm('shaping', 'the distance of the sheep outside, and one for each', _shaping),
):
    REWARD_TERMS.add(_term)
