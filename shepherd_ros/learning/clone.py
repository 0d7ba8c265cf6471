"""Behaviour cloning: fit the actor's mean to what was done by a better one."""

from __future__ import annotations

from dataclasses import dataclass

from shepherd_ros.config import Config, option
from shepherd_ros.policy.policy import Policy
import torch
from torch import nn, Tensor


@dataclass(frozen=True)
class CloneConfig(Config):
    """Options of the fit; all are choices."""

    rate: float = option(5e-4, 'learning rate at first', low=0.0)
    minibatch: int = option(512, 'examples per step of the optimiser', low=1)
    batches: int = option(60, 'steps of the optimiser in a round', low=1)
    newest: int = option(20_000, 'every third batch is from so many of the newest', low=1)
    longest_gradient: float = option(1.0, 'gradients are cut to this norm', low=0.0)


class Examples:
    """The newest examples: scaled frames (K, 3, R), the ray in front, the wanted action (2,)."""

    def __init__(self, policy: Policy, capacity: int, dtype: torch.dtype) -> None:
        """Make an empty store; memory is taken as it fills."""
        config = policy.config
        shape = (config.observation.n_frames, 3, config.lidar.n_rays)
        self.frames = torch.empty(capacity, *shape, dtype=dtype)
        self.first = torch.empty(capacity, dtype=torch.int64)
        self.wanted = torch.empty(capacity, 2)
        self.capacity, self.count = capacity, 0

    def __len__(self) -> int:
        """Return how many there are."""
        return min(self.count, self.capacity)

    def add(self, frames: Tensor, first: Tensor, wanted: Tensor) -> None:
        """Put n examples in place of the oldest; wanted (n, 2) m/s is relative to the ray."""
        at = (self.count + torch.arange(len(first))) % self.capacity
        self.frames[at] = frames.to(self.frames.dtype)
        self.first[at], self.wanted[at] = first, wanted
        self.count += len(first)

    def draw(self, size: int, generator: torch.Generator, newest: int = 0) -> Tensor:
        """Return indices (size,) of random examples, of the newest only if that is not 0."""
        span = min(newest or len(self), len(self))
        back = torch.randint(span, (size,), generator=generator)
        return (self.count - 1 - back) % self.capacity


class Cloner:
    """Fits the actor by least squares."""

    def __init__(self, policy: Policy, config: CloneConfig, seed: int) -> None:
        """Make the optimiser."""
        self.policy, self.config = policy, config
        self.optimiser = torch.optim.Adam(policy.actor.parameters(), config.rate)
        self.generator = torch.Generator().manual_seed(seed)

    def slow_down(self, share: float) -> None:
        """Set the learning rate to a share of that at first."""
        self.optimiser.param_groups[0]['lr'] = self.config.rate * share

    def loss(self, examples: Examples, chosen: Tensor) -> Tensor:
        """Return the mean squared error [m2/s2] of some examples."""
        x = self.policy.arranged(examples.frames[chosen], examples.first[chosen])
        mean, _ = self.policy.actor(x)
        return (mean - examples.wanted[chosen]).square().sum(dim=-1).mean()

    def learn(self, examples: Examples) -> float:
        """Take the steps of a round; return the mean loss."""
        newest = self.config.newest
        losses = [
            self.take_step(examples, newest if i % 3 == 0 else 0)
            for i in range(self.config.batches)
        ]
        return sum(losses) / len(losses)

    def take_step(self, examples: Examples, newest: int = 0) -> float:
        """Learn from one batch, of so many of the newest if that is not 0; return its loss."""
        chosen = examples.draw(self.config.minibatch, self.generator, newest)
        loss = self.loss(examples, chosen)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.policy.actor.parameters(), self.config.longest_gradient)
        self.optimiser.step()
        return float(loss.detach())
