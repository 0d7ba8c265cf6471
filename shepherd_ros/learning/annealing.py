"""Annealing of action_repeat in training: long holds explore at first, single steps come last."""

from __future__ import annotations

from dataclasses import dataclass, replace

from shepherd_ros.config import Config, ConfigError, option
from shepherd_ros.policy.policy import PolicyConfig

GAMMA_TIME = 4.0  # [s] of which gamma is the discount: a decision of eight steps of 0.5 s


@dataclass(frozen=True)
class AnnealConfig(Config):
    """
    Options of the pace; all are choices.

    Actions are held for as long as the policy says for a share of the samples; over the rest the
    time is halved again and again, in stages of equal length.
    """

    anneal_start: float = option(
        0.6, 'share of the samples before actions are held for shorter', low=0.0, high=1.0
    )
    final_action_repeat: int = option(1, 'steps that an action is held in the end', low=1)
    final_min_std: float = option(
        0.1, 'smallest standard deviation of an action in the last stage [m/s]', low=0.001
    )


def stages(first: PolicyConfig, config: AnnealConfig) -> list[PolicyConfig]:
    """Return the policy's configuration by stage; ConfigError if halving misses the end."""
    paces = [first.action_repeat]
    while paces[-1] >= 2 * config.final_action_repeat and paces[-1] % 2 == 0:
        paces.append(paces[-1] // 2)
    if paces[-1] > config.final_action_repeat:
        raise ConfigError(
            f'final_action_repeat is {config.final_action_repeat}: expected a number '
            f'that halving action_repeat, {first.action_repeat}, comes to, such as {paces[-1]}'
        )
    low = first.network.min_std
    result = [first]
    for i, pace in enumerate(paces[1:], start=1):
        share = i / (len(paces) - 1)
        floor = min(low, low * (config.final_min_std / low) ** share)
        result.append(
            replace(first, action_repeat=pace, network=replace(first.network, min_std=floor))
        )
    return result


def stage_at(share: float, count: int, config: AnnealConfig) -> int:
    """Return the stage, of `count`, after a share of the samples."""
    if share < config.anneal_start:
        return 0
    rest = (share - config.anneal_start) / max(1 - config.anneal_start, 1e-9)
    return min(1 + int(rest * (count - 1)), count - 1)


def discount(gamma: float, policy: PolicyConfig) -> float:
    """Return the discount per decision of a policy, where gamma is that per GAMMA_TIME."""
    return gamma ** (policy.action_repeat * policy.dt / GAMMA_TIME)
