"""The learned controller: each shepherd acts on the scans of its own lidar."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from shepherd_ros.config import Config, ConfigError, option
from shepherd_ros.controllers.controller import Controller, CONTROLLERS, Memory
from shepherd_ros.policy import inference
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.lidar import scan
from shepherd_ros.sim.rng import normal, Stream
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor


@dataclass(frozen=True)
class LearnedConfig(Config):
    """Options of the learned controller."""

    checkpoint: str = option('general', 'checkpoint: a file, or the name of one that is shipped')
    sample: bool = option(False, 'draw actions with the spread that the policy learned')
    sample_std: float = option(
        -1.0,
        'standard deviation about the mean with which actions are drawn [m/s]; 0: the mean; '
        'negative: as the checkpoint says. Draws follow from the seed of the episode',
        low=-1.0,
        high=10.0,
    )

    def __post_init__(self) -> None:
        """Check each field, and that there is one spread."""
        super().__post_init__()
        if self.sample and self.sample_std >= 0:
            raise ConfigError(
                f'sample_std is {self.sample_std} m/s: expected -1 with sample, which draws with '
                'the spread of the policy'
            )

    def std_of(self, policy: PolicyConfig) -> float | None:
        """Return the spread of the actions of a policy [m/s], 0: its own; None: the mean acts."""
        if self.sample:
            return 0.0
        return (policy.sample_std if self.sample_std < 0 else self.sample_std) or None


@CONTROLLERS.add
class LearnedController(Controller):
    """Runs a policy for all shepherds; its memory is the scans and the last command of each."""

    name = 'policy'
    config_type = LearnedConfig
    executable = 'policy'
    order = 0

    def __init__(
        self,
        config: LearnedConfig,
        world: WorldConfig,
        policy: Policy | None = None,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        """Load the checkpoint unless a policy is given."""
        super().__init__(config, world)
        if policy is None:
            from shepherd_ros.policy.checkpoint import (
                load_policy,  # heuristics need no safetensors
            )

            policy = load_policy(config.checkpoint)
        require_task(policy, world)
        self.policy = policy
        self.dtype = dtype
        self.timing = self.policy.config.timing(world.dt)
        self.std = config.std_of(self.policy.config)

    @classmethod
    def options_of(cls, text: str) -> dict[str, Any]:
        """
        Return the options of CHECKPOINT or CHECKPOINT@STD, such as general@0.08.

        STD is sample_std [m/s], 0 the mean; without a checkpoint, the default one counts.
        """
        checkpoint, _, number = text.rpartition('@')
        try:
            spread = {'sample_std': float(number)} if '@' in text else {}
        except ValueError:  # it is part of the name of a file
            spread = {}
        checkpoint = checkpoint if spread else text
        return ({'checkpoint': checkpoint} if checkpoint else {}) | spread

    def begin(self, state: WorldState) -> Memory:
        """Return the memory of a team before its first scan."""
        team = state.shepherds.shape[-2]
        return inference.begin(self.policy, self.timing, state.step.shape, team, self.dtype)

    def read_ranges(self, state: WorldState) -> Tensor:
        """Return the ranges of the shepherds' lidars, (..., H, C, R) m."""
        return scan(self.world.task.observed(state), self.policy.config.lidar)

    def act(self, state: WorldState, memory: Memory) -> tuple[Tensor, Memory]:
        """Return commands (..., H, 2) m/s, held between decisions, and memory."""

        def draws() -> Tensor:
            return sample_noise(state.seed, state.step, state.shepherds.shape[-2])

        return inference.act(
            self.policy,
            self.timing,
            lambda: self.read_ranges(state),
            state.shepherd_mask,
            memory,
            self.world.shepherd_speed,
            None if self.std is None else draws,
            std=self.std or 0.0,
        )


def sample_noise(seed: Tensor, step: Tensor, team: int) -> Tensor:
    """Return the standard normal numbers (..., H, 2) of sampled actions of a team."""
    index = torch.arange(2 * team, device=step.device)
    return normal(seed, step, Stream.ACTION, index).unflatten(-1, (-1, 2))


def require_task(policy: Policy, world: WorldConfig) -> None:
    """Raise ConfigError unless the world has the task that a policy was trained for."""
    if world.task.name != policy.config.task:
        raise ConfigError(
            f'task is {world.task.name}: expected {policy.config.task}, for which the policy was '
            'trained; choose a checkpoint that was trained for yours, or another controller'
        )
