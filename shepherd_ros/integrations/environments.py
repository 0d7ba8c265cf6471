"""
The environment in the terms of Gymnasium (single and vector) and of PettingZoo (parallel).

All run sim.env: an observation is the network's input (D, L) float32, an action a velocity (2,)
in units of the top speed, relative to the ray in front of the input. The reward is the team's. A
time limit is a truncation; a task such as protection also has terminal states. Without a seed,
reset() goes on with other episodes than before.

Once this is imported, gymnasium.make('shepherd_ros/Herding-v0', config=EnvConfig(...)) makes one
world with one shepherd, and gymnasium.make_vec() many.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gymnasium
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
import numpy as np
from pettingzoo import ParallelEnv  # type: ignore[import-untyped]
from shepherd_ros.config import ConfigError
from shepherd_ros.integrations.herding_worlds import HerdingWorlds, spaces_of
from shepherd_ros.sim.rollout import EnvConfig
from torch import Tensor

ID = 'shepherd_ros/Herding-v0'


def single_shepherd(config: EnvConfig | None) -> EnvConfig:
    """Return the configuration, by default that of one shepherd; ConfigError for a team."""
    config = config or replace(EnvConfig(), world=replace(EnvConfig().world, n_shepherds=1))
    if config.world.n_shepherds != 1:
        raise ConfigError(
            f'n_shepherds is {config.world.n_shepherds}: expected 1; take HerdingVectorEnv or '
            'HerdingParallelEnv for a team'
        )
    return config


class HerdingEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One world with one shepherd; the info of the last step has the metrics of the episode."""

    metadata = {'render_modes': []}  # noqa: RUF012

    def __init__(self, config: EnvConfig | None = None) -> None:
        """Make the world; reset() starts it."""
        self.worlds = HerdingWorlds(single_shepherd(config), 1)
        self.observation_space, self.action_space = spaces_of(self.worlds.config)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Return observation (D, L) and info."""
        super().reset(seed=seed)
        return self.worlds.reset(seed)[0, 0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Return observation (D, L), reward, ends and info after an action (2,)."""
        obs, reward, *ends, info = self.worlds.step(np.asarray(action)[None, None])
        terminated, truncated = (bool(end[0]) for end in ends)
        episode_info: dict[str, Any] = {}
        if terminated or truncated:
            obs = self.worlds.observe(info['final_observation'])
            episode_info = {name: float(value[0]) for name, value in info['final_metrics'].items()}
        return obs[0, 0], float(reward[0]), terminated, truncated, episode_info


class HerdingVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """
    Every shepherd of every world is one of the num_envs environments, world by world.

    Episodes that end start anew in the same step; `final_obs` in the info is then the observation
    last, and `final_info` has the metrics of each world's episode; masks say whose they are.
    """

    def __init__(self, config: EnvConfig | None = None, n_worlds: int = 8) -> None:
        """Make the worlds; reset() starts them."""
        config = config or EnvConfig()
        self.worlds = HerdingWorlds(config, n_worlds)
        self.team = config.world.n_shepherds
        self.num_envs = n_worlds * self.team
        self.single_observation_space, self.single_action_space = spaces_of(config)
        self.observation_space = gymnasium.vector.utils.batch_space(
            self.single_observation_space, self.num_envs
        )
        self.action_space = gymnasium.vector.utils.batch_space(
            self.single_action_space, self.num_envs
        )
        self.autoreset_mode = AutoresetMode.SAME_STEP
        self.metadata = {'autoreset_mode': self.autoreset_mode}

    def reset(
        self, *, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Return observations (num_envs, D, L) and info; world b starts with seed + b."""
        if isinstance(seed, list):
            raise ConfigError(f'seed is {seed}: expected one number, from which all worlds follow')
        return self._flat(self.worlds.reset(seed)), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Return observations, rewards, terminations, truncations (num_envs,) each, and info."""
        actions_by_world = np.asarray(actions).reshape(-1, self.team, 2)
        obs, reward, terminated, truncated, info = self.worlds.step(actions_by_world)
        episode_info: dict[str, Any] = {}
        if 'final_observation' in info:
            ended = self._each(terminated | truncated)
            episode_info['final_obs'] = self._flat(self.worlds.observe(info['final_observation']))
            final: dict[str, np.ndarray] = {}
            for name, value in info['final_metrics'].items():
                final |= {name: self._each(value), f'_{name}': ended}
            episode_info |= {'final_info': final, '_final_obs': ended, '_final_info': ended}
        ends = self._each(terminated), self._each(truncated)
        return self._flat(obs), self._each(reward), *ends, episode_info

    def _flat(self, obs: np.ndarray) -> np.ndarray:
        return obs.reshape(self.num_envs, *obs.shape[2:])

    def _each(self, value: Tensor) -> np.ndarray:
        """Return values of worlds (B,), repeated for their shepherds (num_envs,)."""
        return value.repeat_interleave(self.team).numpy()


def make_vector_env(*, num_envs: int, config: EnvConfig | None = None) -> HerdingVectorEnv:
    """Return a vector environment of num_envs worlds with one shepherd each."""
    return HerdingVectorEnv(single_shepherd(config), num_envs)


class HerdingParallelEnv(ParallelEnv[str, np.ndarray, np.ndarray]):
    """One world; its agents are shepherd_0, shepherd_1 and so on."""

    metadata = {'name': 'herding_v0', 'render_modes': [], 'is_parallelizable': True}  # noqa: RUF012

    def __init__(self, config: EnvConfig | None = None) -> None:
        """Make the world; reset() starts it."""
        config = config or EnvConfig()
        self.worlds = HerdingWorlds(config, 1)
        self.possible_agents = [f'shepherd_{h}' for h in range(config.world.n_shepherds)]
        self.agents: list[str] = []
        self.render_mode = None
        obs, done = spaces_of(config)
        self.observation_spaces = dict.fromkeys(self.possible_agents, obs)
        self.action_spaces = dict.fromkeys(self.possible_agents, done)

    def observation_space(self, agent: str) -> spaces.Box:
        """Return the observation space of an agent."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Box:
        """Return the action space of an agent."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Return observations and infos."""
        self.agents = list(self.possible_agents)
        obs = self.worlds.reset(seed)
        return self._by_name(obs), {name: {} for name in self.agents}

    def step(
        self, actions: dict[str, np.ndarray]
    ) -> tuple[
        dict[str, np.ndarray],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """
        Return observations, rewards, terminations, truncations and infos by agent.

        They are empty after the end, when all agents are gone.
        """
        self.worlds.env.require_start()
        if not self.agents:
            return {}, {}, {}, {}, {}
        missing = sorted(set(self.agents) - set(actions))
        if missing:
            raise ConfigError(f'actions lack {missing}: expected one for each of {self.agents}')
        stacked = np.stack([actions[name] for name in self.agents])[None]
        obs, reward, *ends, info = self.worlds.step(stacked)
        terminated, truncated = (bool(end[0]) for end in ends)
        names, ended = self.agents, terminated or truncated
        episode_info: dict[str, Any] = {}
        if ended:
            obs = self.worlds.observe(info['final_observation'])
            episode_info = {name: float(value[0]) for name, value in info['final_metrics'].items()}
        result = (
            self._by_name(obs),
            dict.fromkeys(names, float(reward[0])),
            dict.fromkeys(names, terminated),
            dict.fromkeys(names, truncated),
            {name: dict(episode_info) for name in names},
        )
        if ended:
            self.agents = []
        return result

    def render(self) -> None:
        """Do nothing: shepherd bag render draws episodes."""

    def _by_name(self, obs: np.ndarray) -> dict[str, np.ndarray]:
        return dict(zip(self.possible_agents, obs[0], strict=True))


if ID not in gymnasium.registry:
    module = f'{__name__}:'
    gymnasium.register(ID, module + 'HerdingEnv', vector_entry_point=module + 'make_vector_env')
