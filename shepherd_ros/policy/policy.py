"""Policy of a learned shepherd: sensors, frames and network, from scans to velocities."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from math import isclose

from shepherd_ros.config import Config, ConfigError, option, part
from shepherd_ros.policy.network import Actor, Critic, NetworkConfig
from shepherd_ros.policy.timing import Timing
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import (
    arrange,
    first_ray,
    input_shape,
    MAX_FRAME_INTERVAL,
    ObservationConfig,
    rotate_by_ray,
    scaled_ranges,
)
from shepherd_ros.sim.tasks import TASKS
import torch
from torch import nn, Tensor

MAX_FRAME_DECISIONS = 1000  # from one frame to the next


@dataclass(frozen=True)
class PolicyConfig(Config):
    """Configuration of a policy; times are in seconds, whatever the time step of an episode."""

    decision_interval: float = option(
        0.5, 'seconds from one decision to the next, in which an action is held',
        low=0.001, high=MAX_FRAME_INTERVAL,
    )  # fmt: skip
    sample_std: float = option(
        0.0, 'acts by samples of this standard deviation about the mean [m/s]; 0: by the mean',
        low=0.0, high=10.0, sparse=True,
    )  # fmt: skip
    lidar: LidarConfig = part(LidarConfig)
    observation: ObservationConfig = part(ObservationConfig)
    network: NetworkConfig = part(NetworkConfig)
    task: str = option(
        'herding', 'task that it was trained for', choices=lambda: tuple(TASKS), sparse=True
    )

    def __post_init__(self) -> None:
        """Check each field, and times and padding against the others."""
        super().__post_init__()
        interval, held = self.observation.frame_interval, self.decision_interval
        decisions = round(interval / held)
        if not 1 <= decisions <= MAX_FRAME_DECISIONS or not isclose(decisions * held, interval):
            raise ConfigError(
                f'frame_interval is {interval} s: expected 1 to {MAX_FRAME_DECISIONS} times '
                f'decision_interval, {held} s, as frames are taken when an action is chosen'
            )
        if self.network.padding == 'circular' and self.observation.layout != 'ring':
            raise ConfigError(
                f'layout is {self.observation.layout!r}: expected ring with circular padding, '
                'as only there the last ray is beside the first'
            )

    def timing(self, dt: float) -> Timing:
        """Return decisions and frames in episodes with steps of dt [s]."""
        obs = self.observation
        return Timing(self.decision_interval, obs.frame_interval, obs.n_frames, dt)


class Policy(nn.Module):
    """Actor and critic with their configuration; both read the same input."""

    def __init__(
        self, config: PolicyConfig, actor: Actor | None = None, critic: Critic | None = None
    ) -> None:
        """Use the networks, or create them with random weights from torch's generator."""
        super().__init__()
        self.config = config
        types, n_rays = config.lidar.layout.shape
        shape = input_shape(config.observation, n_rays, types)
        self.actor = actor or Actor(shape, config.network)
        self.critic = critic or Critic(shape, config.network)

    @property
    def device(self) -> torch.device:
        """Return the device of the networks."""
        return next(self.parameters()).device

    def with_config(self, config: PolicyConfig) -> Policy:
        """Return a policy that shares these weights, with another configuration."""
        actor = copy(self.actor)
        actor.config = config.network
        return Policy(config, actor, self.critic)

    def scale(self, ranges: Tensor) -> Tensor:
        """Return ranges (...) m in the unit of the network, free rays as none_value."""
        return scaled_ranges(ranges, self.config.observation, self.config.lidar.range_max)

    def first_ray(self, ranges: Tensor) -> Tensor:
        """Return the first ray (...) int64 of the input for the newest frames (..., C, R) m."""
        return first_ray(ranges, self.config.observation)

    def arrange(self, scaled: Tensor, first: Tensor) -> Tensor:
        """Return the input (..., D, L) of scaled frames (..., K, C, R), ray first (...) first."""
        return arrange(scaled, first, self.config.observation)

    @torch.no_grad()
    def act(
        self, frames: Tensor, draws: Tensor | None = None, dtype: torch.dtype = torch.float32
    ) -> Tensor:
        """
        Return velocities (n, 2) m/s in the world frame, not cut to the top speed.

        frames (n, K, C, R) m are readings, +inf on free rays, newest last. draws (n, 2) are
        standard normal numbers for a sampled action; None: the mean. dtype is that of the work.
        """
        first = self.first_ray(frames[:, -1])
        return self.act_on(self.scale(frames).to(dtype), first, draws)

    @torch.no_grad()
    def act_on(
        self, scaled: Tensor, first: Tensor, draws: Tensor | None = None, spread: float = 0.0
    ) -> Tensor:
        """
        Return act() for frames of scale(), (n, K, C, R), and their first ray (n,).

        spread [m/s] takes the place of the policy's own standard deviation unless it is 0.
        """
        if not len(scaled):
            return torch.zeros(0, 2, device=scaled.device)
        mean, std = self.actor(self.arrange(scaled, first))
        action = mean if draws is None else mean + (spread or std) * draws
        return rotate_by_ray(action, first, scaled.shape[-1])
