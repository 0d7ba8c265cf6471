"""The learned controller: each shepherd acts on the scans of its own lidar."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from shepherd_ros.config import Config, option
from shepherd_ros.controllers.controller import Controller, CONTROLLERS, Memory
from shepherd_ros.policy import inference
from shepherd_ros.policy.policy import Policy
from shepherd_ros.sim.lidar import scan
from shepherd_ros.sim.rng import normal, Stream
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor


@dataclass(frozen=True)
class LearnedConfig(Config):
    """Options of the learned controller."""

    checkpoint: str = option('imitation', 'checkpoint: a file, or the name of one that is shipped')
    sample: bool = option(False, 'draw actions from the policy; false: its mean')


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
        self.policy = policy
        self.dtype = dtype
        self.timing = self.policy.config.timing(world.dt)

    @classmethod
    def options_of(cls, text: str) -> dict[str, Any]:
        """Return the checkpoint that the text names; without any, the default one."""
        return {'checkpoint': text} if text else {}

    def begin(self, state: WorldState) -> Memory:
        """Return the memory of a team before its first scan."""
        team = state.shepherds.shape[-2]
        return inference.begin(self.policy, self.timing, state.step.shape, team, self.dtype)

    def read_ranges(self, state: WorldState) -> Tensor:
        """Return the ranges of the shepherds' lidars, (..., H, C, R) m."""
        return scan(state, self.policy.config.lidar)

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
            draws if self.config.sample else None,
        )


def sample_noise(seed: Tensor, step: Tensor, team: int) -> Tensor:
    """Return the standard normal numbers (..., H, 2) of sampled actions of a team."""
    index = torch.arange(2 * team, device=step.device)
    return normal(seed, step, Stream.ACTION, index).unflatten(-1, (-1, 2))
