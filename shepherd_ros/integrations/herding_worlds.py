"""The worlds behind the environments of all libraries, in numpy, and their spaces."""

from __future__ import annotations

import secrets
from typing import Any

from gymnasium import spaces
import numpy as np
from shepherd_ros.config import ConfigError
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.observation import first_ray, input_shape, network_input, rotate_by_ray
from shepherd_ros.sim.rollout import EnvConfig
import torch
from torch import Tensor


def spaces_of(config: EnvConfig) -> tuple[spaces.Box, spaces.Box]:
    """Return the spaces of the observation and of the action of one shepherd."""
    observation, lidar = config.observation, config.lidar
    highest = max(lidar.range_max / (observation.unit or lidar.range_max), observation.none_value)
    types, n_rays = lidar.layout.shape
    shape = input_shape(observation, n_rays, types)
    return (
        spaces.Box(min(observation.none_value, 0.0), highest, shape, np.float32),
        spaces.Box(-1.0, 1.0, (2,), np.float32),
    )


class HerdingWorlds:
    """Worlds of sim.env: stacks to inputs, actions to commands."""

    def __init__(self, config: EnvConfig, n_worlds: int) -> None:
        """Make the worlds; reset() starts them."""
        if config.world.spawn.fewest_shepherds:
            raise ConfigError(
                f'fewest_shepherds is {config.world.spawn.fewest_shepherds}: expected 0, as the '
                'number of agents is fixed here; make an environment for each team size'
            )
        self.config = config
        self.env = ShepherdEnv(config, n_worlds)
        self.first = torch.zeros(n_worlds, config.world.n_shepherds, dtype=torch.int64)

    def observe(self, stack: Tensor | None) -> np.ndarray:
        """Return the inputs (B, H, D, L) of stacks (B, H, K, C, R) m."""
        assert stack is not None
        observation = self.config.observation
        inputs = network_input(stack, observation, self.config.lidar.range_max)
        return inputs.numpy()

    def reset(self, seed: int | None) -> np.ndarray:
        """Start new episodes; return inputs (B, H, D, L). The first seed is random by default."""
        if seed is None and not self.env.started:
            seed = secrets.randbits(63)
        stack, _ = self.env.reset(seed)
        return self._observe_stack(stack)

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Return inputs, reward, terminated, truncated (B,) and info after actions (B, H, 2)."""
        speed = self.config.world.shepherd_speed
        velocity = torch.as_tensor(action, dtype=torch.float32) * speed
        command = rotate_by_ray(velocity, self.first, self.config.lidar.n_rays)
        stack, reward, terminated, truncated, info = self.env.step(command)
        return self._observe_stack(stack), reward, terminated, truncated, info

    def _observe_stack(self, stack: Tensor | None) -> np.ndarray:
        assert stack is not None
        self.first = first_ray(stack[..., -1, :, :], self.config.observation)
        return self.observe(stack)
