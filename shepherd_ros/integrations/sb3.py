"""
Our worlds for Stable-Baselines3: each shepherd is an environment, so that all share a policy.

An action is held for some time, which is one step of the learner; its direction stays relative
to the ray in front. `scripts/train_sb3.py` uses all of this.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

from gymnasium import spaces, Wrapper
import numpy as np
from shepherd_ros.config import ConfigError
from shepherd_ros.integrations.environments import HerdingVectorEnv
from shepherd_ros.sim.frames import nearest_steps
from shepherd_ros.sim.metrics import shown
from shepherd_ros.sim.rollout import EnvConfig
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn
import torch
from torch import nn, Tensor

Infos = list[dict[str, Any]]


def hold_steps(config: EnvConfig, decision_interval: float) -> int:
    """Return the steps of a time [s] from one decision to the next, or raise ConfigError."""
    steps, dt = config.world.episode_steps, config.world.dt
    hold = nearest_steps(decision_interval, dt)
    if steps % hold:
        raise ConfigError(
            f'decision_interval is {decision_interval} s, {hold} steps of {dt} s: expected a '
            f'divisor of episode_steps, {steps}'
        )
    return hold


class HerdingVecEnv(VecEnv):
    """The worlds of environments.HerdingVectorEnv in the terms of Stable-Baselines3."""

    def __init__(self, config: EnvConfig, n_worlds: int, decision_interval: float = 0.0) -> None:
        """Make the worlds; an action is held for the nearest number of steps, at least one."""
        self.hold = hold_steps(config, decision_interval)
        self.env = HerdingVectorEnv(config, n_worlds)
        self.actions = np.zeros((self.env.num_envs, 2), np.float32)
        obs, done = self.env.single_observation_space, self.env.single_action_space
        super().__init__(self.env.num_envs, obs, done)

    def reset(self) -> np.ndarray:
        """Return observations (num_envs, D, L); seed() sets the seed of world 0."""
        obs, _ = self.env.reset(seed=self._seeds[0])
        self._reset_seeds()
        return obs

    def step_async(self, actions: np.ndarray) -> None:
        """Store actions (num_envs, 2) in units of the top speed for step_wait()."""
        self.actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Return observations, rewards (sums over the steps), ends (num_envs,) and infos."""
        total = np.zeros(self.num_envs, np.float32)
        infos: Infos = [{'TimeLimit.truncated': False} for _ in total]
        ended = np.zeros(self.num_envs, bool)
        for _ in range(self.hold):
            obs, reward, terminated, truncated, info = self.env.step(self.actions)
            # what a new episode does before its first action counts for nothing
            total += np.where(ended, 0.0, reward).astype(np.float32)
            self._note_ends(infos, (terminated | truncated) & ~ended, truncated, info)
            ended |= terminated | truncated
        return obs, total, ended, cast(Any, infos)

    @staticmethod
    def _note_ends(
        infos: Infos, ends: np.ndarray, truncated: np.ndarray, info: dict[str, Any]
    ) -> None:
        """Write the episodes that end now, (num_envs,) bool, into infos."""
        for i in ends.nonzero()[0]:
            final = info['final_info'].items()
            metrics = {name: float(value[i]) for name, value in final if name[0] != '_'}
            infos[i] = {
                'TimeLimit.truncated': bool(truncated[i]),
                'terminal_observation': info['final_obs'][i],
                'metrics': metrics,
            }

    def close(self) -> None:
        """Do nothing: the worlds hold no files and no processes."""

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the vector environment, once for each of some environments."""
        return [getattr(self.env, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Refuse: the environments are one object."""
        raise AttributeError(f'{attr_name} cannot be set for single shepherds')

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Refuse: the environments are one object."""
        raise AttributeError(f'{method_name}() cannot be called for single shepherds')

    def env_is_wrapped(
        self, wrapper_class: type[Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Return False for each: there are no wrappers inside."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return None for each: shepherd bag render draws episodes."""
        return [None] * self.num_envs


class LidarFeatures(BaseFeaturesExtractor):
    """Two convolutions over the rays and a dense layer, smaller than the paper's."""

    def __init__(self, observation_space: spaces.Box, features_dim: int = 128) -> None:
        """Make the layers for inputs (D, L)."""
        super().__init__(observation_space, features_dim)
        channels, length = observation_space.shape
        self.rays = nn.Sequential(
            nn.Conv1d(channels, 32, 8, stride=4),
            nn.ReLU(),
            nn.Conv1d(32, 32, 4, stride=2),
            nn.ReLU(),
            nn.Flatten(),
        )
        width = self.rays(torch.zeros(1, channels, length)).shape[-1]
        self.dense = nn.Sequential(nn.Linear(width, features_dim), nn.ReLU())

    def forward(self, observations: Tensor) -> Tensor:
        """Return features (B, features_dim) of inputs (B, D, L)."""
        features: Tensor = self.dense(self.rays(observations))
        return features


def evaluate(
    model: BaseAlgorithm, config: EnvConfig, n_worlds: int, decision_interval: float, seed: int
) -> dict[str, float]:
    """Return the mean return and metrics of one episode in each world, by the mean action."""
    env = HerdingVecEnv(config, n_worlds, decision_interval)
    env.seed(seed)
    obs: Any = env.reset()
    total, metrics = np.zeros(env.num_envs), cast(Infos, [{} for _ in range(env.num_envs)])
    for _ in range(config.world.episode_steps // env.hold):
        action, _ = model.predict(obs, deterministic=True)
        obs, reward, _, infos = env.step(action)
        total += [0.0 if m else r for m, r in zip(metrics, reward, strict=True)]
        metrics = [m or info.get('metrics', {}) for m, info in zip(metrics, infos, strict=True)]
    means = {
        metric.name: float(np.mean([values[metric.name] for values in metrics]))
        for metric in shown('eval', config.world.task.metrics)
    }
    return {'return': float(total.mean()), **means}
