"""Behaviour cloning: fit of the actor's mean to the commands of a teacher."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from shepherd_ros.config import Config, option
from shepherd_ros.policy.policy import Policy
import torch
from torch import nn, Tensor
from torch.nn import functional
from torch.optim.swa_utils import AveragedModel

Weights = list[Tensor] | tuple[Tensor, ...]
GATE_WEIGHT = 0.1  # [m2/s2] of the cross-entropy of the gate, beside errors of commands
EMA_WARMUP_STEPS = 10  # at first, the mean is over one in so many of the steps so far


@dataclass(frozen=True)
class CloneConfig(Config):
    """Options of the fit; all are choices."""

    learning_rate: float = option(5e-4, 'learning rate at first', low=0.0)
    batch_size: int = option(512, 'examples per step of the optimiser', low=1)
    updates_per_round: int = option(60, 'steps of the optimiser in a round', low=1)
    recent_examples: int = option(20_000, 'every third batch is from so many of the newest', low=1)
    max_grad_norm: float = option(1.0, 'gradients are cut to this norm', low=0.0)
    huber_delta: float = option(
        0.15, 'errors beyond this count in proportion, not squared [m/s]', low=0.001
    )
    clip_speed: float = option(
        0.0,
        'the mean is cut to this for its error [m/s]',
        low=0.0,
    )
    gate_weight: float = option(GATE_WEIGHT, 'weight of the cross-entropy of the gate', low=0.0)
    hold_weight: float = option(1.0, 'weight of errors while the teacher holds', low=0.0)
    ema_decay: float = option(0.998, 'share of the mean weights kept in a step', low=0.0, high=1.0)


class Examples:
    """
    The newest examples: scaled frames (K, C, R), the ray in front, the wanted action (2,).

    With them come the mode of the teacher, hold or drive, and the weight of their error.
    """

    COLUMNS = ('frames', 'first', 'wanted', 'hold', 'weight')

    def __init__(self, policy: Policy, capacity: int, dtype: torch.dtype) -> None:
        """Create an empty store; its memory is used as it fills."""
        config = policy.config
        shape = (config.observation.n_frames, *config.lidar.layout.shape)
        self.frames = torch.empty(capacity, *shape, dtype=dtype)
        self.first = torch.empty(capacity, dtype=torch.int64)
        self.wanted = torch.empty(capacity, 2)
        self.hold = torch.zeros(capacity, dtype=torch.bool)
        self.weight = torch.ones(capacity)
        self.capacity, self.count = capacity, 0

    def state_dict(self) -> dict[str, Any]:
        """Return the examples in the store, and the number of all so far."""
        parts = {name: getattr(self, name)[: len(self)] for name in self.COLUMNS}
        return {'count': self.count, **{name: values.clone() for name, values in parts.items()}}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state that state_dict() returned."""
        self.count = state['count']
        for name in self.COLUMNS:
            getattr(self, name)[: len(self)] = state[name]

    def __len__(self) -> int:
        """Return the number of examples in the store."""
        return min(self.count, self.capacity)

    def add(
        self,
        frames: Tensor,
        first: Tensor,
        wanted: Tensor,
        hold: Tensor | bool = False,
        weight: Tensor | float = 1.0,
    ) -> None:
        """
        Replace the oldest by n examples; wanted (n, 2) m/s is relative to the first ray.

        hold (n,) bool is the mode of the teacher, weight (n,) that of the error.
        """
        index = (self.count + torch.arange(len(first))) % self.capacity
        self.frames[index] = frames.to(self.frames.dtype)
        self.first[index], self.wanted[index] = first, wanted
        self.hold[index], self.weight[index] = (
            torch.as_tensor(hold), torch.as_tensor(weight, dtype=torch.float32)
        )  # fmt: skip
        self.count += len(first)

    def draw(self, size: int, generator: torch.Generator, newest: int = 0) -> Tensor:
        """Return indices (size,) of random examples, of the newest only if that is not 0."""
        span = min(newest or len(self), len(self))
        offset = torch.randint(span, (size,), generator=generator)
        return (self.count - 1 - offset) % self.capacity


def running_mean(decay: float) -> Callable[[Weights, Weights, Tensor | int], None]:
    """Return the update of a running mean with this decay, which is faster at first."""

    def update(average: Weights, new: Weights, count: Tensor | int) -> None:
        weight = max(1 - decay, EMA_WARMUP_STEPS / (float(count) + EMA_WARMUP_STEPS))
        for mean, value in zip(average, new, strict=True):
            mean.lerp_(value, weight)

    return update


def cut_to(mean: Tensor, speed: float) -> Tensor:
    """Return actions (n, 2) that are no longer than a speed [m/s], as they are if it is 0."""
    if not speed:
        return mean
    length = torch.linalg.vector_norm(mean, dim=-1, keepdim=True)
    return mean * (speed / length.clamp(min=speed))


class CloneLearner:
    """
    Fits the actor to examples.

    A running mean of its weights is steadier than the newest: averaged() gives them to a policy.
    """

    def __init__(self, policy: Policy, config: CloneConfig, seed: int) -> None:
        """Create the optimiser and the running mean."""
        self.policy, self.config = policy, config
        self.optimiser = torch.optim.Adam(policy.actor.parameters(), config.learning_rate)
        self.generator = torch.Generator().manual_seed(seed)
        self.average = AveragedModel(policy.actor, multi_avg_fn=running_mean(config.ema_decay))

    def state_dict(self) -> dict[str, Any]:
        """Return the state of the learner."""
        parts = ('policy', 'optimiser', 'average')
        state = {name: getattr(self, name).state_dict() for name in parts}
        return {**state, 'generator': self.generator.get_state()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state that state_dict() returned."""
        for name in ('policy', 'optimiser', 'average'):
            getattr(self, name).load_state_dict(state[name])
        self.generator.set_state(state['generator'])

    def averaged(self, policy: Policy) -> Policy:
        """Set the actor's weights of a policy to the running mean; return the policy."""
        policy.actor.load_state_dict(self.average.module.state_dict())
        return policy

    def scale_learning_rate(self, share: float) -> None:
        """Set the learning rate to a fraction of the initial one."""
        self.optimiser.param_groups[0]['lr'] = self.config.learning_rate * share

    def loss(self, examples: Examples, chosen: Tensor) -> Tensor:
        """
        Return the mean squared error [m2/s2] of some examples, of outliers as in Huber (1964).

        Where a teacher may turn either way, squares ask for the mean, which is to stand still, and
        hide all finer errors; in proportion, they ask for one of the two. With two modes, the
        error is that of the teacher's mode, and the gate has the cross-entropy with it.
        """
        config, actor = self.config, self.policy.actor
        out = actor.outputs(self.policy.arrange(examples.frames[chosen], examples.first[chosen]))
        gate, hold = actor.gate(out), examples.hold[chosen]
        mean, _ = actor.action_of(out, None if gate is None else hold)
        mean = cut_to(mean, config.clip_speed)
        error = torch.linalg.vector_norm(mean - examples.wanted[chosen], dim=-1)
        bound = config.huber_delta
        loss = torch.where(error < bound, error.square(), bound * (2 * error - bound))
        if gate is not None:
            entropy = functional.binary_cross_entropy_with_logits(
                gate, hold.float(), reduction='none'
            )
            loss = loss * torch.where(hold, config.hold_weight, 1.0) + config.gate_weight * entropy
        weight = examples.weight[chosen]
        if (weight == 1).all():
            return loss.mean()
        return (loss * weight).sum() / weight.sum()

    def learn(self, examples: Examples) -> float:
        """Train for the steps of a round; return the mean loss."""
        newest = self.config.recent_examples
        losses = [
            self.train_batch(examples, newest if i % 3 == 0 else 0)
            for i in range(self.config.updates_per_round)
        ]
        return sum(losses) / len(losses)

    def train_batch(self, examples: Examples, newest: int = 0) -> float:
        """Train on one batch, of the `newest` examples if that is not 0; return its loss."""
        chosen = examples.draw(self.config.batch_size, self.generator, newest)
        loss = self.loss(examples, chosen)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.policy.actor.parameters(), self.config.max_grad_norm)
        self.optimiser.step()
        self.average.update_parameters(self.policy.actor)
        return float(loss.detach())
