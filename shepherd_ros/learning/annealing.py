"""Annealing of decision_interval in training: long holds explore at first, short ones act last."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

from shepherd_ros.config import Config, ConfigError, option
from shepherd_ros.policy.policy import PolicyConfig
from shepherd_ros.policy.timing import Timing

GAMMA_TIME = 4.0  # [s] of which gamma is the discount: the first decisions of our trainings


@dataclass(frozen=True)
class AnnealConfig(Config):
    """
    Options of the pace; all are choices.

    Actions are held for as long as the policy says for a share of the samples; over the rest the
    time is halved again and again, in stages of equal length.
    """

    anneal_start: float = option(
        0.6, 'share of the samples before holds get shorter', low=0.0, high=1.0
    )
    final_decision_interval: float = option(
        0.5, 'seconds that an action is held in the end', low=0.001
    )
    final_min_std: float = option(0.1, 'least deviation of actions in the end [m/s]', low=0.001)


def stages(first: PolicyConfig, config: AnnealConfig) -> list[PolicyConfig]:
    """Return the policy's configuration by stage; ConfigError if halving misses the end."""
    held, final = first.decision_interval, config.final_decision_interval
    halvings = max(round(math.log2(held / final)), 0)
    intervals = [held / 2**k for k in range(halvings + 1)]
    if final < held and not math.isclose(intervals[-1], final):
        raise ConfigError(
            f'final_decision_interval is {final} s: expected a time that halving '
            f'decision_interval, {held} s, comes to, such as {intervals[-1]:g}'
        )
    low = first.network.min_std
    result = [first]
    for i, interval in enumerate(intervals[1:], start=1):
        share = i / halvings
        floor = min(low, low * (config.final_min_std / low) ** share)
        network = replace(first.network, min_std=floor)
        result.append(replace(first, decision_interval=interval, network=network))
    return result


def stage_at(share: float, count: int, config: AnnealConfig) -> int:
    """Return the stage, of `count`, after a share of the samples."""
    if share < config.anneal_start:
        return 0
    rest = (share - config.anneal_start) / max(1 - config.anneal_start, 1e-9)
    return min(1 + int(rest * (count - 1)), count - 1)


def discount(gamma: float, timing: Timing) -> float:
    """Return the discount per decision of a policy, where gamma is that per GAMMA_TIME."""
    return gamma ** (timing.decision_interval / GAMMA_TIME)
