"""Decisions of a policy in many worlds at once, with all that a learner wants to know of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

from shepherd_ros.learning.distributed import rank
from shepherd_ros.learning.gae import advantages
from shepherd_ros.learning.task import draw_environment, TaskConfig
from shepherd_ros.policy.policy import Policy
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import turned
from shepherd_ros.sim.rollout import advance, Moment, start
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor

CPU = torch.device('cpu')
STRANGERS = 15_485_863  # seeds from one process to the next
SEEDS_APART = 1_000_003  # from an episode of a group to its next

Reward = Callable[[Moment], Tensor]  # of each shepherd after a step, (B, H)


def team_reward(moment: Moment) -> Tensor:
    """Return the paper's reward, the same for all of a team."""
    return moment.reward[:, None].expand(moment.state.shepherd_mask.shape)


class Group:
    """Worlds of one configuration, which begin and end their episodes together."""

    def __init__(
        self,
        task: TaskConfig,
        index: int,
        n_worlds: int,
        seed: int,
        lidar: LidarConfig,
        *,
        count: bool = False,
        device: torch.device = CPU,
    ) -> None:
        """Make the group; begin() starts its first episode. count: with the tally of metrics."""
        self.task, self.index, self.n_worlds, self.seed = task, index, n_worlds, seed
        self.lidar, self.count, self.device = lidar, count, device
        self.episode = 0
        self.terms: dict[str, Tensor] = {}  # sums over steps of the mean of each term

    moment: Moment
    left: int  # steps until the episode is cut

    def begin(self, steps: int) -> None:
        """Start an episode of so many steps, in a world that is drawn from the task."""
        seed = self.seed + SEEDS_APART * self.episode + 1000 * self.index
        config = replace(draw_environment(self.task, seed), lidar=self.lidar)
        seeds = seed + torch.arange(self.n_worlds, device=self.device)
        self.moment = start(spawn(config.world, seeds), config, self.count)
        self.left, self.episode = steps, self.episode + 1

    def state_dict(self) -> dict[str, Any]:
        """Return the episode and where it is."""
        now = self.moment.state
        state = {f.name: getattr(now, f.name) for f in fields(now)}
        return {'episode': self.episode, 'left': self.left, 'state': state}

    def load_state_dict(self, kept: dict[str, Any]) -> None:
        """Go on from what state_dict() gave."""
        self.episode = kept['episode'] - 1
        self.begin(kept['left'])
        state = {name: t.to(self.device) for name, t in kept['state'].items()}
        self.moment = start(WorldState(**state), self.moment.config, self.count)

    def step(self, command: Tensor) -> None:
        """Go on by a step with a command (B, H, 2) m/s."""
        self.moment = advance(self.moment, command)
        self.left -= 1

    def hold(self, command: Tensor, repeat: int, reward: Reward) -> Tensor:
        """
        Hold a command (B, H, 2) m/s for some steps; return the sum of the rewards, (B, H).

        What the way costs, `effort`, is each shepherd's own, and no term of its team's reward.
        """
        total, effort = command.new_zeros(command.shape[:-1]), self.task.effort
        for _ in range(repeat):
            self.step(command)
            now = self.moment
            total += reward(now)
            terms = now.reward_terms
            if effort > 0:
                way = torch.linalg.vector_norm(now.state.shepherds - now.before.shepherds, dim=-1)
                total -= effort * way
                terms = terms | {'effort': -effort * way}
            for name, term in terms.items():
                self.terms[name] = self.terms.get(name, 0.0) + term.mean()
        return total


@dataclass
class Batch:
    """Decisions of all shepherds that were there, n of them in no order."""

    rows: Tensor  # (n, K) int64: the frames of each in the store
    first: Tensor  # (n,) int64: ray in front
    action: Tensor  # (n, 2) m/s, relative to that ray
    log_prob: Tensor  # (n,)
    value: Tensor  # (n,)
    advantage: Tensor  # (n,)


def log_prob(action: Tensor, mean: Tensor, std: Tensor) -> Tensor:
    """Return the logarithm of the normal density, up to a constant; (n, 2) -> (n,)."""
    return (-0.5 * ((action - mean) / std).square() - std.log()).sum(dim=-1)


class Rollout:
    """
    Groups of worlds and a store of what their shepherds saw.

    Frames are kept once, scaled, in the dtype of the work; stacks are put together when they are
    read, and do not reach over the start of an episode.
    """

    KEPT = ('store', 'first', 'begun', 'mask')

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
    ) -> None:
        """
        Start groups x worlds worlds; collect() makes that many decisions in each.

        All is where the policy is.
        """
        self.device = device = policy.device
        self.reward = reward
        repeat = policy.config.repeat
        self.policy, self.dtype, self.decisions = policy, dtype, decisions
        # each process draws and starts for itself
        self.generator = torch.Generator(device).manual_seed(seed + STRANGERS * rank())
        self.steps = task.episode_steps // repeat * repeat
        self.groups = [
            Group(task, g + rank() * groups, worlds, seed, policy.config.lidar, device=device)
            for g in range(groups)
        ]
        self.before = policy.config.frames.window - 1  # rows kept from earlier decisions
        shape = (groups, self.before + decisions + 1, worlds, task.shepherds_max)
        scan = policy.config.lidar.layout.shape
        self.store = torch.zeros(*shape, *scan, dtype=dtype, device=device)
        self.first = torch.zeros(shape, dtype=torch.int64, device=device)
        # row in which the episode began
        self.begun = torch.zeros(shape[:2], dtype=torch.int64, device=device)
        self.mask = torch.zeros(shape, dtype=torch.bool, device=device)
        for g, group in enumerate(self.groups):
            # the first episodes are of different length, so that not all end at once
            cut = self.steps * (g + 1) // groups // repeat * repeat
            group.begin(max(cut, repeat))
            self._see(g, self.before, starts=True)

    def _see(self, g: int, row: int, starts: bool = False) -> None:
        """Put what a group sees now in a row of the store."""
        moment = self.groups[g].moment
        ranges = moment.ranges
        self.store[g, row] = self.policy.scaled(ranges).to(self.dtype)
        self.first[g, row] = self.policy.first_ray(ranges)
        self.begun[g, row] = row if starts else self.begun[g, row - 1]
        self.mask[g, row] = moment.state.shepherd_mask

    def rows_of(self, g: Tensor, row: Tensor, world: Tensor, shepherd: Tensor) -> Tensor:
        """Return the rows (n, K) of the flat store that hold the frames of n decisions."""
        seen = self.policy.config.frames.rows(row, self.begun[g, row])
        _, rows, worlds, team = self.mask.shape
        return ((g[:, None] * rows + seen) * worlds + world[:, None]) * team + shepherd[:, None]

    def inputs(self, rows: Tensor, first: Tensor) -> Tensor:
        """Return the network's input (n, D, L) for rows (n, K) of the store."""
        frames = self.store.flatten(0, 3)[rows]
        return self.policy.arranged(frames, first)

    def _present(self, row: int, groups: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return indices (n,) of the shepherds of some groups that are there in a row."""
        g, world, shepherd = self.mask[groups, row].nonzero().unbind(dim=-1)
        return groups[g], torch.full_like(g, row), world, shepherd

    @torch.no_grad()
    def _values(self, row: int, groups: Tensor) -> tuple[tuple[Tensor, ...], Tensor]:
        """Return who is there in a row, and the critic's value for each."""
        who = self._present(row, groups)
        return who, self.policy.critic(self.inputs(self.rows_of(*who), self.first[who]))

    @torch.no_grad()
    def collect(self, gamma: float, decay: float, scale: float) -> tuple[Batch, dict[str, float]]:
        """
        Make the decisions; return them and means of the reward and of its terms.

        scale multiplies the reward, so that values are of order one.
        """
        policy, shape = self.policy, (*self.mask.shape[:1], self.decisions, *self.mask.shape[2:])
        repeat, n_rays = policy.config.repeat, policy.config.lidar.n_rays
        device = self.device
        action = torch.zeros(*shape, 2, device=device)
        density, value, next_value, reward = (torch.zeros(shape, device=device) for _ in range(4))
        ended = torch.zeros(shape[:2], dtype=torch.bool, device=CPU)
        everyone = torch.arange(len(self.groups), device=device)
        for group in self.groups:
            group.terms = {}
        for t in range(self.decisions):
            row = self.before + t
            who = self._present(row, everyone)
            g, _, world, shepherd = who
            at = (g, torch.full_like(g, t), world, shepherd)
            first = self.first[who]
            x = self.inputs(self.rows_of(*who), first)
            mean, std = policy.actor(x)
            chosen = mean + std * torch.randn(mean.shape, generator=self.generator, device=device)
            action[at], density[at] = chosen, log_prob(chosen, mean, std)
            value[at] = policy.critic(x)
            command = torch.zeros(*self.mask[:, 0].shape, 2, device=device)
            command[g, world, shepherd] = turned(chosen, first, n_rays)
            for i, group in enumerate(self.groups):
                reward[i, t] = group.hold(command[i], repeat, self.reward) * scale
                self._see(i, row + 1)
                ended[i, t] = group.left <= 0
            over = ended[:, t].nonzero()[:, 0].to(device)
            if len(over):
                (g, _, world, shepherd), last = self._values(row + 1, over)
                next_value[g, t, world, shepherd] = last
                for i in over.tolist():
                    self.groups[i].begin(self.steps)
                    self._see(i, row + 1, starts=True)
        ended = ended.to(device)
        (g, _, world, shepherd), last = self._values(self.before + self.decisions, everyone)
        final = torch.zeros_like(value[:, 0])
        final[g, world, shepherd] = last
        following = torch.cat([value[:, 1:], final[:, None]], dim=1)
        next_value = torch.where(ended[:, :, None, None], next_value, following)
        gain = advantages(
            reward.transpose(0, 1),
            value.transpose(0, 1),
            next_value.transpose(0, 1),
            ended.T[..., None, None],
            gamma,
            decay,
        ).transpose(0, 1)
        rows = slice(self.before, self.before + self.decisions)
        g, time, world, shepherd = self.mask[:, rows].nonzero().unbind(dim=-1)
        at, who = (g, time, world, shepherd), (g, time + self.before, world, shepherd)
        batch = Batch(
            self.rows_of(*who), self.first[who], action[at], density[at], value[at], gain[at]
        )
        return batch, {'reward': float(reward.mean() / scale / repeat)} | self._terms(repeat)

    def _terms(self, repeat: int) -> dict[str, float]:
        """Return the mean of each term of the reward over all worlds and steps."""
        steps = len(self.groups) * self.decisions * repeat
        names = dict.fromkeys(name for group in self.groups for name in group.terms)
        return {
            f'reward/{name}': float(sum(group.terms[name] for group in self.groups)) / steps
            for name in names
        }

    def roll(self) -> None:
        """Make room for the next decisions; the batch of the last ones is void afterwards."""
        for kept in (self.store, self.first, self.mask):
            kept[:, : self.before + 1] = kept[:, self.decisions :].clone()
        begun = self.begun[:, self.decisions :] - self.decisions
        self.begun[:, : self.before + 1] = begun.clamp(min=0)

    def state_dict(self) -> dict[str, Any]:
        """Return all that collecting goes on from, after roll()."""
        rows = slice(0, self.before + 1)
        return {
            'groups': [group.state_dict() for group in self.groups],
            'generator': self.generator.get_state(),
            **{name: getattr(self, name)[:, rows].clone() for name in self.KEPT},
        }

    def load_state_dict(self, kept: dict[str, Any]) -> None:
        """Go on from what state_dict() gave."""
        for group, state in zip(self.groups, kept['groups'], strict=True):
            group.load_state_dict(state)
        self.generator.set_state(kept['generator'].to(CPU))
        for name in self.KEPT:
            getattr(self, name)[:, : self.before + 1] = kept[name]
