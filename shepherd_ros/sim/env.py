"""Many worlds at once, in the terms of Gymnasium's vector environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from shepherd_ros.config import ConfigError
from shepherd_ros.sim.rng import mixed_seeds
from shepherd_ros.sim.rollout import advance, EnvConfig, Moment, restart, start
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor


class ShepherdEnv:
    """
    B worlds that step together; one that ends starts anew at once (Gymnasium's same-step mode).

    Observations are stacks of ranges (B, H, K, C, R) [m], +inf on free rays, newest frame last;
    without lidar they are None, for controllers that read `perceived`. Actions are (B, H, 2)
    [m/s], world frame. World b starts with seed + b; the seeds of its later episodes are mixed of
    seed, b and their number, so that environments with other seeds have other episodes.
    """

    def __init__(
        self, config: EnvConfig, n_worlds: int, *, lidar: bool = True, device: str = 'cpu'
    ) -> None:
        """Make the worlds; reset() starts them."""
        if n_worlds < 1:
            raise ValueError(f'n_worlds is {n_worlds}: expected at least 1')
        self.config, self.frames = config, config.observation.frames(config.world.dt)
        self.n_worlds = n_worlds
        self.lidar = lidar
        self.device = torch.device(device)

    moment: Moment
    stack: Tensor | None  # the observation of it
    _window: Tensor
    _key: list[int]  # the seeds of reset()
    _episode: Tensor  # (B,) number of each world's episode since then

    @property
    def state(self) -> WorldState:
        """Return the true state."""
        return self.moment.state

    @property
    def perceived(self) -> WorldState:
        """Return the state as controllers and lidars perceive it."""
        return self.moment.perceived

    @property
    def started(self) -> bool:
        """Return whether there was a reset()."""
        return hasattr(self, 'moment')

    def require_start(self) -> None:
        """Raise ConfigError before the first reset()."""
        if not self.started:
            raise ConfigError('the environment has not started: expected reset() before step()')

    def reset(
        self, seed: int | Sequence[int] | None = None
    ) -> tuple[Tensor | None, dict[str, Any]]:
        """
        Start every world, b with seed + b or its own seed; return observation and info.

        Without a seed they go on with the episodes after the last ones, at first with those of 0.
        """
        if seed is None and self.started:
            seeds = self._next_episodes(torch.tensor(True))
        else:
            key = [*seed] if isinstance(seed, Sequence) else [seed or 0]
            own = key if isinstance(seed, Sequence) else [key[0] + b for b in range(self.n_worlds)]
            if len(own) != self.n_worlds:
                raise ConfigError(f'seed is {seed}: expected one, or {self.n_worlds}')
            self._key = key
            seeds = torch.tensor(own, device=self.device)
            self._episode = torch.zeros_like(seeds)
        self.moment, self.stack = start(spawn(self.config.world, seeds), self.config), None
        if self.lidar:
            self._update_window(self.frames.begin(self.moment.ranges))
        return self.stack, {'seed': seeds}

    def step(self, action: Tensor) -> tuple[Tensor | None, Tensor, Tensor, Tensor, dict[str, Any]]:
        """
        Return observation, reward (B,), terminated (B,), truncated (B,) and info after one step.

        A time limit is truncated and to be bootstrapped, the end of a task is terminated and not.
        info has `reward_terms`; where an episode ends, also `final_observation`, `final_state` and
        `final_metrics` of all B worlds as they were before those that ended started anew.
        """
        self.require_start()
        self.moment = last = advance(self.moment, action)
        if self.lidar:
            self._update_window(self.frames.push(self._window, last.ranges))
        terminated, truncated = last.terminated, last.truncated
        ended = terminated | truncated
        info: dict[str, Any] = {'reward_terms': last.reward_terms}
        if ended.any():
            info |= {
                'final_observation': self.stack,
                'final_state': last.state,
                'final_metrics': last.metrics(),
            }
            fresh = spawn(self.config.world, self._next_episodes(ended))
            self.moment = restart(last, ended, fresh)
            if self.lidar:
                self._update_window(self.frames.restart(self._window, self.moment.ranges, ended))
        return self.stack, last.reward, terminated, truncated, info

    def _next_episodes(self, ended: Tensor) -> Tensor:
        """Return the seeds (B,) of the episodes that begin where others ended, (B,) bool."""
        self._episode = self._episode + ended
        seeds = self.moment.state.seed
        for k in self._episode[ended.expand_as(seeds)].unique().tolist():
            mixed = mixed_seeds(self.n_worlds, *self._key, k).to(self.device)
            seeds = torch.where(ended & (self._episode == k), mixed, seeds)
        return seeds

    def metrics(self) -> dict[str, Tensor]:
        """Return the metrics of the running episodes so far, (B,) each."""
        return self.moment.metrics()

    def _update_window(self, window: Tensor) -> None:
        """Store the window (B, H, W, C, R) of readings, and the observation of it."""
        self._window, self.stack = window, self.frames.select(window)
