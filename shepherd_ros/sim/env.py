"""Many worlds at once, in the terms of Gymnasium's vector environments."""

from __future__ import annotations

from typing import Any

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
    [m/s], world frame. World b starts with seed + b, and its k-th episode with seed + b + k B, so
    an episode is the same whatever the number of worlds.
    """

    def __init__(
        self, config: EnvConfig, n_worlds: int, *, lidar: bool = True, device: str = 'cpu'
    ) -> None:
        """Make the worlds; reset() starts them."""
        if n_worlds < 1:
            raise ValueError(f'n_worlds is {n_worlds}: expected at least 1')
        self.config, self.frames = config, config.observation.frames
        self.n_worlds = n_worlds
        self.lidar = lidar
        self.device = torch.device(device)

    moment: Moment
    stack: Tensor | None  # what is observed of it
    _window: Tensor

    @property
    def state(self) -> WorldState:
        """Return the true state."""
        return self.moment.state

    @property
    def perceived(self) -> WorldState:
        """Return the state as controllers and lidars perceive it."""
        return self.moment.perceived

    def reset(self, seed: int = 0) -> tuple[Tensor | None, dict[str, Any]]:
        """Start every world; world b with seed + b. Return observation and info."""
        seeds = seed + torch.arange(self.n_worlds, device=self.device)
        self.moment, self.stack = start(spawn(self.config.world, seeds), self.config), None
        if self.lidar:
            self._see(self.frames.begin(self.moment.ranges))
        return self.stack, {'seed': seeds}

    def step(self, action: Tensor) -> tuple[Tensor | None, Tensor, Tensor, Tensor, dict[str, Any]]:
        """
        Return observation, reward (B,), terminated (B,), truncated (B,) and info after one step.

        A time limit is truncated and to be bootstrapped; nothing is terminated, as Moment says.
        info has `reward_terms`; where an episode ends, also `final_observation`, `final_state` and
        `final_metrics` of all B worlds as they were before those that ended started anew.
        """
        self.moment = last = advance(self.moment, action)
        if self.lidar:
            self._see(self.frames.push(self._window, last.ranges))
        terminated, truncated = last.terminated, last.truncated
        ended = terminated | truncated
        info: dict[str, Any] = {'reward_terms': last.reward_terms}
        if ended.any():
            info |= {
                'final_observation': self.stack,
                'final_state': last.state,
                'final_metrics': last.metrics(),
            }
            fresh = spawn(self.config.world, last.state.seed + self.n_worlds)
            self.moment = restart(last, ended, fresh)
            if self.lidar:
                self._see(self.frames.restart(self._window, self.moment.ranges, ended))
        return self.stack, last.reward, terminated, truncated, info

    def metrics(self) -> dict[str, Tensor]:
        """Return the metrics of the running episodes so far, (B,) each."""
        return self.moment.metrics()

    def _see(self, window: Tensor) -> None:
        """Take the window of readings as the present one."""
        self._window, self.stack = window, self.frames.seen(window)
