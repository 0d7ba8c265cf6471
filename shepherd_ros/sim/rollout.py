"""
The rollout: perceive, scan, act, step, count, one moment after the other.

A loop over an episode reads a moment, commands, and goes on from there::

    moment = start(spawn(config.world, seeds), config)
    while not moment.ended.all():
        command, memory = controller.act(moment.perceived, memory)
        moment = advance(moment, command)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from shepherd_ros.config import Config, option, part
from shepherd_ros.sim.lidar import LidarConfig, scan
from shepherd_ros.sim.metrics import count_step, metrics, MetricsTally, start_tally
from shepherd_ros.sim.observation import ObservationConfig
from shepherd_ros.sim.perception import perceive
from shepherd_ros.sim.reward import reward_terms, RewardConfig
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


@dataclass(frozen=True)
class Moment:
    """
    Worlds (...) at one step of their episodes, with scans, reward and metrics derived from it.

    Derived values are computed at their first read, and once.
    """

    config: EnvConfig
    state: WorldState
    before: WorldState  # one step earlier; the first state is its own
    tally: MetricsTally | None  # None: not counted

    @cached_property
    def perceived(self) -> WorldState:
        """Return the state with the noise of perception."""
        return perceive(self.state, self.config.noise_std)

    @cached_property
    def ranges(self) -> Tensor:
        """Return the ranges of the lidars, (..., H, C, R) m, +inf on free rays."""
        return scan(self.config.world.task.observed(self.perceived), self.config.lidar)

    @cached_property
    def reward_terms(self) -> dict[str, Tensor]:
        """Return the terms of the reward for the last step, (...) each; 0 after the end."""
        config, task = self.config, self.config.world.task
        steps = config.world.episode_steps
        terms = reward_terms(self.state, config.reward, steps, self.before, task.terms)
        if not task.ends:
            return terms
        over = task.terminated(self.before)
        return {name: torch.where(over, 0.0, term) for name, term in terms.items()}

    @property
    def reward(self) -> Tensor:
        """Return the sum of the terms, (...)."""
        return torch.stack(list(self.reward_terms.values())).sum(dim=0)

    @cached_property
    def terminated(self) -> Tensor:
        """Return the mask of terminal states, (...) bool: those in which the task has ended."""
        return self.config.world.task.terminated(self.state)

    @cached_property
    def truncated(self) -> Tensor:
        """Return the mask of worlds at the time limit, (...) bool; values are bootstrapped."""
        late = self.state.step >= self.config.world.episode_steps
        return late & ~self.terminated if self.config.world.task.ends else late

    @property
    def ended(self) -> Tensor:
        """Return the mask of worlds whose episode is over, (...) bool."""
        return self.terminated | self.truncated

    def metrics(self, episode_steps: int | None = None) -> dict[str, Tensor]:
        """
        Return the metrics of the episode so far, (...) each.

        episode_steps is the length of the whole episode, the world's by default.
        """
        assert self.tally is not None
        steps = self.config.world.episode_steps if episode_steps is None else episode_steps
        return metrics(self.tally, self.state, steps, self.config.world.task.metrics)


def start(state: WorldState, config: EnvConfig, count: bool = True) -> Moment:
    """Return the first moment of episodes; count: with the tally of the metrics."""
    tally = start_tally(state, config.world.task.metrics) if count else None
    return Moment(config, state, state, tally)


def advance(moment: Moment, command: Tensor, goal: Tensor | None = None) -> Moment:
    """Return the moment after a command (..., H, 2) m/s; goal (2,) m: its new position."""
    state = step(moment.state, command, moment.config.world)
    if goal is not None:
        state = replace(state, goal=goal.expand_as(state.goal))
    return advance_to(moment, state)


def advance_to(moment: Moment, state: WorldState) -> Moment:
    """
    Return the moment in the next state, which was recorded or received.

    Worlds (B) in a terminal state stay as they are, with reward 0 and the same metrics.
    """
    tally, task = moment.tally, moment.config.world.task
    if tally is not None:
        tally = count_step(tally, moment.state, state, task.metrics)
    if task.ends and moment.terminated.any():
        if not moment.terminated.dim():
            return replace(moment, before=moment.state)
        state = where(moment.terminated, moment.state, state)
        if tally is not None and moment.tally is not None:
            tally = moment.tally.where(moment.terminated, tally)
    return Moment(moment.config, state, moment.state, tally)


def restart(moment: Moment, ended: Tensor, state: WorldState) -> Moment:
    """Return the moment with new episodes in a first state where they ended, (B,) bool."""
    tally = moment.tally
    if tally is not None:
        tally = start_tally(state, moment.config.world.task.metrics).where(ended, tally)
    return replace(
        moment,
        state=where(ended, state, moment.state),
        before=where(ended, state, moment.before),
        tally=tally,
    )
