"""Proximal policy optimisation (Schulman et al. 2017): one update from a batch of decisions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from shepherd_ros.config import Config, option
from shepherd_ros.experiments.methods import full_name
from shepherd_ros.learning.clone import GATE_WEIGHT
from shepherd_ros.learning.distributed import all_reduce, least, ranks, total
from shepherd_ros.learning.ppo_rollout import Batch, log_prob
from shepherd_ros.learning.state_critic import StateCritic
from shepherd_ros.learning.store import Store
from shepherd_ros.policy.network import Actor
from shepherd_ros.policy.policy import Policy
import torch
from torch import nn, Tensor
from torch.nn.functional import binary_cross_entropy_with_logits
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn


@dataclass(frozen=True)
class PPOConfig(Config):
    """Options of the update; all are choices, as the paper gives none."""

    gamma: float = option(0.96, 'discount per 4 s, whatever the hold', low=0.0, high=1.0)
    gae_lambda: float = option(0.95, 'lambda of the advantages', low=0.0, high=1.0)
    clip_coef: float = option(0.2, 'the probability ratio is cut to 1 -+ this', low=0.0, high=1.0)
    update_epochs: int = option(3, 'times that each decision is learned from', low=1)
    minibatch_size: int = option(1024, 'decisions per step of the optimiser', low=1)
    actor_learning_rate: float = option(1e-4, 'learning rate of the actor at first', low=0.0)
    critic_learning_rate: float = option(3e-4, 'learning rate of the critic at first', low=0.0)
    entropy_coef: float = option(0.002, 'weight of the entropy', low=0.0)
    max_grad_norm: float = option(0.5, 'gradients are cut to this norm', low=0.0)
    critic_input: str = option(
        'scans',
        'what its critic sees; state: the true one',
        choices=('scans', 'state'),
    )
    learn_share: float = option(1.0, 'share of the decisions it learns from', low=0.01, high=1.0)
    teacher: str = option('', 'controller to learn from at home; empty: none')
    label_weight: float = option(1.0, 'weight of the error against them', low=0.0)
    ema_decay: float = option(
        0.995,
        'the policy that is kept is a running mean of the weights, by this',
        low=0.0,
        high=1.0,
    )
    target_kl: float = option(0.04, 'the actor rests for the update beyond this', low=0.0)

    def __post_init__(self) -> None:
        """Check each field and the name of the teacher."""
        super().__post_init__()
        if self.teacher:
            full_name(self.teacher)


def clipped_loss(ratio: Tensor, advantage: Tensor, clip: float) -> Tensor:
    """Return the loss of the actor, before the mean; (n,) each."""
    return -torch.minimum(ratio * advantage, ratio.clamp(1 - clip, 1 + clip) * advantage)


def approximate_kl(log_ratio: Tensor) -> Tensor:
    """Return an estimate of the mean divergence from old to new that is never negative; (n,)."""
    return (log_ratio.exp() - 1 - log_ratio).mean()


def explained_variance(prediction: Tensor, target: Tensor) -> float:
    """Return the fraction of the target's variance that is explained, 0 for a single sample."""
    if len(target) < 2:
        return 0.0
    return float(1 - (target - prediction).var() / target.var().clamp(min=1e-12))


def normalised(advantage: Tensor) -> Tensor:
    """Return advantages with mean 0 and deviation 1 over all processes."""
    if ranks() == 1:
        spread = advantage.std() if len(advantage) > 1 else advantage.new_zeros(())
        return (advantage - advantage.mean()) / spread.clamp(min=1e-8)
    count = total(len(advantage))
    mean = total(float(advantage.sum())) / count
    variance = total(float((advantage - mean).square().sum())) / max(count - 1, 1)
    return (advantage - mean) / max(variance**0.5, 1e-8)


def label_loss(actor: Actor, out: Tensor, label: Tensor, home: Tensor) -> Tensor:
    """
    Return the error of outputs (n, outputs) against labels (n, 2) m/s where the flock is home.

    It is the squared error, 0 elsewhere, [m2/s2]. Of two modes it is that of hold, and the gate
    has a tenth of its cross-entropy with home (n,) everywhere.
    """
    gate = actor.gate(out)
    mean, _ = actor.action_of(out, None if gate is None else torch.ones_like(home))
    error = ((mean - label).square().sum(dim=-1) * home).mean()
    if gate is None:
        return error
    return error + GATE_WEIGHT * binary_cross_entropy_with_logits(gate, home.float())


class PPOLearner:
    """A policy with an optimiser for its actor and one for a critic."""

    def __init__(self, policy: Policy, config: PPOConfig) -> None:
        """Create the optimisers and the running mean."""
        self.policy, self.config = policy, config
        self.on_state = config.critic_input == 'state'
        with policy.device:
            self.critic_network: nn.Module = StateCritic() if self.on_state else policy.critic
        self.actor = torch.optim.Adam(
            policy.actor.parameters(), config.actor_learning_rate, eps=1e-5
        )
        self.critic = torch.optim.Adam(
            self.critic_network.parameters(), config.critic_learning_rate, eps=1e-5
        )
        self.average = AveragedModel(
            policy.actor, multi_avg_fn=get_ema_multi_avg_fn(config.ema_decay)
        )

    def state_dict(self) -> dict[str, Any]:
        """Return the state of the optimisers and the networks."""
        return {name: part.state_dict() for name, part in self._parts().items()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state that state_dict() returned."""
        for name, part in self._parts().items():
            part.load_state_dict(state[name])

    def _parts(self) -> dict[str, Any]:
        """Return the parts that have a state, by name."""
        return {
            'policy': self.policy,
            'actor': self.actor,
            'critic': self.critic,
            'average': self.average,
            **({'critic_network': self.critic_network} if self.on_state else {}),
        }

    def averaged(self) -> Policy:
        """Return a policy of its own with the running mean of the actor's weights."""
        with self.policy.device:
            policy = Policy(self.policy.config)
        policy.actor.load_state_dict(self.average.module.state_dict())
        policy.critic.load_state_dict(self.policy.critic.state_dict())
        return policy

    def state_critic(self) -> StateCritic | None:
        """Return the critic on the true state, None where the policy's own learns."""
        return self.critic_network if isinstance(self.critic_network, StateCritic) else None

    def scale_learning_rate(self, share: float) -> None:
        """Set the learning rates to a fraction of the initial ones."""
        self.actor.param_groups[0]['lr'] = self.config.actor_learning_rate * share
        self.critic.param_groups[0]['lr'] = self.config.critic_learning_rate * share

    def update(
        self, store: Store, batch: Batch, generator: torch.Generator, actor: bool = True
    ) -> dict[str, float]:
        """
        Train on a batch, in place; return logged scalars. actor False: critic only.

        With several processes, each has a batch of its own, and all take the same steps:
        gradients are means over all samples of a minibatch, of all processes.
        """
        target = batch.advantage + batch.value
        advantage = normalised(batch.advantage)
        names = ('actor_loss', 'critic_loss', 'kl', 'std', 'label_loss')
        scalars: dict[str, list[float]] = {name: [] for name in names}
        for chosen in self._minibatches(batch.value, generator):
            share = len(chosen) / total(len(chosen))  # of the samples of this step
            rows = batch.rows[chosen]
            x = store.inputs(rows, batch.first[chosen]) if actor or not self.on_state else None
            if actor and x is not None:
                actor = self._actor_step(x, batch, chosen, advantage[chosen], share, scalars)
            value = self.critic_network(store.features_at(rows) if self.on_state else x)
            error = (value - target[chosen]).square().mean()
            scalars['critic_loss'].append(float(error.detach()))
            self._descend(self.critic, self.critic_network, error * share)
        means = {name: sum(values) / len(values) for name, values in scalars.items() if values}
        return means | {
            'actor_steps': float(len(scalars['actor_loss'])),
            'explained_variance': explained_variance(batch.value, target),
        }

    def _minibatches(self, values: Tensor, generator: torch.Generator) -> Iterator[Tensor]:
        """Yield the indices of each minibatch, for all times that decisions are learned from."""
        config, size = self.config, len(values)
        learned = None
        if config.learn_share < 1:
            order = torch.randperm(size, generator=generator, device=generator.device)
            learned = order[: max(round(config.learn_share * size), 1)]
            size = len(learned)
        for _ in range(config.update_epochs):
            order = torch.randperm(size, generator=generator, device=generator.device)
            order = (order if learned is None else learned[order]).to(values.device)
            parts = [
                part
                for part in order.split(config.minibatch_size)
                # a rest is a poor estimate
                if len(part) >= config.minibatch_size // 2 or size <= config.minibatch_size
            ]
            yield from parts[: least(len(parts))]

    def _actor_step(
        self,
        x: Tensor,
        batch: Batch,
        chosen: Tensor,
        advantage: Tensor,
        share: float,
        scalars: dict[str, list[float]],
    ) -> bool:
        """Improve the actor on chosen decisions; return False, without a step, where it rests."""
        config, network = self.config, self.policy.actor
        out = network.outputs(x)
        mean, std = network.action_of(out, batch.modes(chosen))
        log_ratio = log_prob(batch.action[chosen], mean, std) - batch.log_prob[chosen]
        kl = total(share * float(approximate_kl(log_ratio.detach())))
        scalars['kl'].append(kl)
        if kl > config.target_kl:
            return False
        loss = clipped_loss(log_ratio.exp(), advantage, config.clip_coef).mean()
        scalars['actor_loss'].append(float(loss.detach()))
        scalars['std'].append(float(std.detach().mean()))
        loss = loss - config.entropy_coef * std.log().sum(dim=-1).mean()
        if batch.label is not None and batch.home is not None:
            taught = label_loss(network, out, batch.label[chosen], batch.home[chosen])
            scalars['label_loss'].append(float(taught.detach()))
            loss = loss + config.label_weight * taught
        self._descend(self.actor, network, loss * share)
        self.average.update_parameters(network)
        return True

    def _descend(self, optimiser: torch.optim.Adam, network: nn.Module, loss: Tensor) -> None:
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        all_reduce(p.grad for p in network.parameters() if p.grad is not None)
        nn.utils.clip_grad_norm_(network.parameters(), self.config.max_grad_norm)
        optimiser.step()
