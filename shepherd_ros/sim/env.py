"""Many worlds at once, in the terms of Gymnasium's vector environments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from shepherd_ros.config import Config, option, part
from shepherd_ros.sim.lidar import LidarConfig, scan
from shepherd_ros.sim.metrics import count_step, metrics, MetricsTally, start_tally
from shepherd_ros.sim.observation import (
    first_stack,
    frames_of,
    history_length,
    ObservationConfig,
    push_frame,
)
from shepherd_ros.sim.perception import perceive
from shepherd_ros.sim.reward import reward_terms, RewardConfig
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import where, WorldState
from shepherd_ros.sim.transition import step
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor


@dataclass(frozen=True)
class EnvConfig(Config):
    """A world, its sensors and its reward."""

    noise_std: float = option(0.0, 'noise on all perceived positions [m]', low=0.0)
    world: WorldConfig = part(WorldConfig)
    lidar: LidarConfig = part(LidarConfig)
    observation: ObservationConfig = part(ObservationConfig)
    reward: RewardConfig = part(RewardConfig)


class ShepherdEnv:
    """
    B worlds that step together; one that ends starts anew at once (Gymnasium's same-step mode).

    Observations are stacks of ranges (B, H, K, 3, R) [m], +inf on free rays, newest frame last;
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
        self.config = config
        self.n_worlds = n_worlds
        self.lidar = lidar
        self.device = torch.device(device)

    state: WorldState
    perceived: WorldState
    tally: MetricsTally
    stack: Tensor | None
    _history: Tensor | None

    def reset(self, seed: int = 0) -> tuple[Tensor | None, dict[str, Any]]:
        """Start every world; world b with seed + b. Return observation and info."""
        seeds = seed + torch.arange(self.n_worlds, device=self.device)
        self._begin(spawn(self.config.world, seeds))
        return self.stack, {'seed': seeds}

    def step(self, action: Tensor) -> tuple[Tensor | None, Tensor, Tensor, Tensor, dict[str, Any]]:
        """
        Return observation, reward (B,), terminated (B,), truncated (B,) and info after one step.

        terminated stays False: the task has no end but its time limit, which is truncated and to
        be bootstrapped. info has `reward_terms`; where truncated, also `final_observation`,
        `final_state` and `final_metrics` of all B worlds as they were before those that ended
        started anew.
        """
        config, before = self.config, self.state
        after = step(before, action, config.world)
        self.tally = count_step(self.tally, before, after)
        terms = reward_terms(after, config.reward, config.world.episode_steps)
        self._look(after, push=True)
        truncated = after.step >= config.world.episode_steps
        info: dict[str, Any] = {'reward_terms': terms}
        if truncated.any():
            info |= {
                'final_observation': self.stack,
                'final_state': after,
                'final_metrics': metrics(self.tally, after, config.world.episode_steps),
            }
            self._restart(truncated)
        terminated = torch.zeros_like(truncated)
        reward = torch.stack(list(terms.values())).sum(dim=0)
        return self.stack, reward, terminated, truncated, info

    def metrics(self) -> dict[str, Tensor]:
        """Return the metrics of the running episodes so far, (B,) each."""
        return metrics(self.tally, self.state, self.config.world.episode_steps)

    def _look(self, state: WorldState, push: bool) -> None:
        """Take the state as the present one and perceive it."""
        self.state = state
        self.perceived = perceive(state, self.config.noise_std)
        if not self.lidar:
            self.stack = self._history = None
            return
        ranges = scan(self.perceived, self.config.lidar)
        if push and self._history is not None:
            self._history = push_frame(self._history, ranges)
        else:
            self._history = first_stack(ranges, history_length(self.config.observation))
        self.stack = frames_of(self._history, self.config.observation)

    def _begin(self, state: WorldState) -> None:
        """Start all worlds in a state."""
        self._look(state, push=False)
        self.tally = start_tally(state)

    def _restart(self, ended: Tensor) -> None:
        """Start new episodes where they ended, (B,) bool; the other worlds stay as they are."""
        old_state, old_history, old_tally = self.state, self._history, self.tally
        fresh = spawn(self.config.world, old_state.seed + self.n_worlds)
        self._begin(where(ended, fresh, old_state))
        if old_history is not None and self._history is not None:
            chosen = ended[:, None, None, None, None]
            self._history = torch.where(chosen, self._history, old_history)
            self.stack = frames_of(self._history, self.config.observation)
        self.tally = self.tally.where(ended, old_tally)
