"""Rollout of a policy in many worlds at once, with values, rewards and advantages for PPO."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from shepherd_ros.learning.distributed import rank
from shepherd_ros.learning.gae import advantages
from shepherd_ros.learning.group import CPU, Reward, team_reward, WorldGroup
from shepherd_ros.learning.home_labels import HomeLabels
from shepherd_ros.learning.state_critic import StateCritic
from shepherd_ros.learning.store import Store
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.policy.policy import Policy
from shepherd_ros.sim.observation import rotate_by_ray
from shepherd_ros.sim.rng import mixed_seeds
from shepherd_ros.sim.tasks import TASKS
import torch
from torch import Tensor


@dataclass
class Decisions:
    """The decisions of a rollout, (G, T, B, H) each unless said otherwise; 0 for the absent."""

    action: Tensor  # (G, T, B, H, 2) m/s, relative to the ray in front
    log_prob: Tensor
    value: Tensor
    hold: Tensor | None  # bool, the mode of the action; None with one mode
    next_value: Tensor  # where the episode ends; 0 in a terminal state
    reward: Tensor
    ended: Tensor  # (G, T, B) bool


@dataclass
class Batch:
    """Decisions of all present shepherds, n of them, without order."""

    rows: Tensor  # (n, K) int64: the frames of each in the store
    first: Tensor  # (n,) int64: ray in front
    action: Tensor  # (n, 2) m/s, relative to that ray
    log_prob: Tensor  # (n,)
    value: Tensor  # (n,)
    advantage: Tensor  # (n,)
    hold: Tensor | None  # (n,) bool, the mode of the action; None with one mode
    label: Tensor | None = None  # (n, 2) m/s, relative to that ray, of the teacher; None without
    home: Tensor | None = None  # (n,) bool, whether the teacher teaches there

    def modes(self, chosen: Tensor) -> Tensor | None:
        """Return the modes of some decisions, None with one mode."""
        return None if self.hold is None else self.hold[chosen]


def log_prob(action: Tensor, mean: Tensor, std: Tensor) -> Tensor:
    """Return the logarithm of the normal density, up to a constant; (n, 2) -> (n,)."""
    return (-0.5 * ((action - mean) / std).square() - std.log()).sum(dim=-1)


class Rollout:
    """Groups of worlds with a store of their observations."""

    def __init__(
        self,
        task: TaskConfig,
        policy: Policy,
        groups: int,
        worlds: int,
        decisions: int,
        seed: int,
        dtype: torch.dtype,
        reward: Reward = team_reward,
        critic: StateCritic | None = None,
        teacher: str = '',
    ) -> None:
        """
        Start groups x worlds worlds; collect() makes that many decisions in each.

        critic takes the place of the policy's own; teacher labels the states at home. All tensors
        are on the device of the policy.
        """
        self.policy, self.decisions, self.reward = policy, decisions, reward
        self.timing = policy.config.timing(task.dt)
        self.device, repeat = policy.device, self.timing.action_repeat
        self.two_modes = policy.config.network.modes == 2
        # each process draws and starts for itself
        mixed = int(mixed_seeds(1, seed, rank()))
        self.generator = torch.Generator(self.device).manual_seed(mixed)
        self.steps = task.episode_steps // repeat * repeat
        self.terminates, self.critic = TASKS[task.task].ends, critic
        self.store = Store(
            policy,
            self.timing.frames,
            groups,
            worlds,
            task.shepherds_max,
            decisions,
            dtype,
            critic is not None,
        )
        lidar, own_groups = policy.config.lidar, range(rank() * groups, (rank() + 1) * groups)
        self.groups = [
            WorldGroup(task, g, worlds, seed, lidar, device=self.device) for g in own_groups
        ]
        self.labels = HomeLabels(teacher, groups, self.store.mask.shape[2:], decisions)
        for g, group in enumerate(self.groups):
            # the first episodes are of different length, so that not all end at once
            length = self.steps * (g + 1) // groups // repeat * repeat
            group.begin(max(length, repeat))
            self.labels.begin(g, group.moment)
            self.store.put(g, self.store.before, group.moment, starts=True)

    @torch.no_grad()
    def collect(
        self, gamma: float, gae_lambda: float, scale: float
    ) -> tuple[Batch, dict[str, float]]:
        """
        Make the decisions; return them and means of the reward and of its terms.

        scale multiplies the reward, so that values are of order one.
        """
        repeat = self.timing.action_repeat
        shape = (len(self.groups), self.decisions, *self.store.mask.shape[2:])
        action = torch.zeros(*shape, 2, device=self.device)
        log_probs, value, following, reward = action.new_zeros(4, *shape)
        ended = torch.zeros(shape[:3], dtype=torch.bool, device=self.device)
        hold = torch.zeros_like(value, dtype=torch.bool) if self.two_modes else None
        made = Decisions(action, log_probs, value, hold, following, reward, ended)
        for group in self.groups:
            group.terms = {}
        for t in range(self.decisions):
            command = self._decide(t, made)
            for g, group in enumerate(self.groups):
                self.labels.add(g, t, group.moment)
            for g, group in enumerate(self.groups):
                made.reward[g, t] = group.hold(command[g], repeat, self.reward) * scale
                self.store.put(g, self.store.before + t + 1, group.moment)
            self._restart_worlds(t, made)
        batch = self._batch(made, gamma, gae_lambda)
        return batch, {'reward': float(made.reward.mean() / scale / repeat)} | self._terms(repeat)

    def _decide(self, t: int, made: Decisions) -> Tensor:
        """Fill in decision t of all present shepherds; return commands (G, B, H, 2) m/s."""
        policy, store, device = self.policy, self.store, self.device
        agents = store.present(store.before + t, torch.arange(len(self.groups), device=device))
        g, _, world, shepherd = agents
        index, first = (g, torch.full_like(g, t), world, shepherd), store.first[agents]
        x = store.inputs(store.rows_of(*agents), first)
        out = policy.actor.outputs(x)
        hold = policy.actor.hold(out)
        mean, std = policy.actor.action_of(out, hold)
        if made.hold is not None and hold is not None:
            made.hold[index] = hold
        chosen = mean + std * torch.randn(mean.shape, generator=self.generator, device=device)
        made.action[index], made.log_prob[index] = chosen, log_prob(chosen, mean, std)
        made.value[index] = self._value(store.rows_of(*agents), x)
        command = torch.zeros_like(made.action[:, 0])
        command[g, world, shepherd] = rotate_by_ray(chosen, first, policy.config.lidar.n_rays)
        return command

    def _restart_worlds(self, t: int, made: Decisions) -> None:
        """Fill in the next value where an episode ends after decision t, and start another."""
        row, terminal = self.store.before + t + 1, [g.moment.terminated for g in self.groups]
        cut = [g for g, group in enumerate(self.groups) if group.left <= 0]
        if cut:
            limit = torch.tensor(cut, device=self.device)
            made.ended[limit, t] = True
            made.next_value[limit, t] = self._values(row, limit)[limit]
        for g, group in enumerate(self.groups):
            if g not in cut and not (self.terminates and terminal[g].any()):
                continue
            made.ended[g, t] |= terminal[g]
            made.next_value[g, t, terminal[g]] = 0.0
            if g in cut:
                group.begin(self.steps)
                self.labels.begin(g, group.moment)
            else:
                group.restart(terminal[g])
            self.store.put(g, row, group.moment, starts=True if g in cut else terminal[g])

    def _values(self, row: int, groups: Tensor) -> Tensor:
        """Return the critic's values (G, B, H) in a row, 0 for the absent and other groups."""
        store = self.store
        agents = store.present(row, groups)
        g, _, world, shepherd = agents
        values = torch.zeros(store.mask[:, 0].shape, device=self.device)
        rows = store.rows_of(*agents)
        x = None if self.critic else store.inputs(rows, store.first[agents])
        values[g, world, shepherd] = self._value(rows, x)
        return values

    def _value(self, rows: Tensor, x: Tensor | None) -> Tensor:
        """Return the values (n,) of decisions with frames in rows (n, K), which show x."""
        if self.critic is None:
            return self.policy.critic(x)
        return self.critic(self.store.features_at(rows))

    def _batch(self, made: Decisions, gamma: float, gae_lambda: float) -> Batch:
        """Return the decisions of the present shepherds, with their advantages."""
        store, all_groups = self.store, torch.arange(len(self.groups), device=self.device)
        ended = made.ended[..., None]  # (G, T, B, 1)
        final = self._values(store.before + self.decisions, all_groups)
        following = torch.cat([made.value[:, 1:], final[:, None]], dim=1)
        advantage = advantages(
            made.reward.transpose(0, 1),
            made.value.transpose(0, 1),
            torch.where(ended, made.next_value, following).transpose(0, 1),
            ended.transpose(0, 1),
            gamma,
            gae_lambda,
        ).transpose(0, 1)
        rows = slice(store.before, store.before + self.decisions)
        g, time, world, shepherd = store.mask[:, rows].nonzero().unbind(dim=-1)
        index, agents = (g, time, world, shepherd), (g, time + store.before, world, shepherd)
        return Batch(
            store.rows_of(*agents), store.first[agents],
            made.action[index], made.log_prob[index], made.value[index], advantage[index],
            None if made.hold is None else made.hold[index],
            *self.labels.of(index, store.first[agents]),
        )  # fmt: skip

    def _terms(self, repeat: int) -> dict[str, float]:
        """Return the mean of each term of the reward over all worlds and steps."""
        steps = len(self.groups) * self.decisions * repeat
        names = dict.fromkeys(name for group in self.groups for name in group.terms)
        return {
            f'reward/{name}': float(sum(group.terms[name] for group in self.groups)) / steps
            for name in names
        }

    def roll(self) -> None:
        """Make room for the next decisions; the last batch is invalid afterwards."""
        self.store.roll()

    def state_dict(self) -> dict[str, Any]:
        """Return the state of the rollout, after roll()."""
        return {
            'groups': [group.state_dict() for group in self.groups],
            'generator': self.generator.get_state(),
            'labels': self.labels.state_dict(),
            **self.store.state_dict(),
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the state that state_dict() returned."""
        for group, state in zip(self.groups, state_dict['groups'], strict=True):
            group.load_state_dict(state)
        self.generator.set_state(state_dict['generator'].to(CPU))
        self.labels.load_state_dict(state_dict['labels'], [g.moment for g in self.groups])
        self.store.load_state_dict(state_dict)
