"""Groups of worlds in which a learner acts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

from shepherd_ros.learning.task import draw_environment, start_of, TaskConfig
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.rng import mixed_seeds
from shepherd_ros.sim.rollout import advance, Moment, restart, start
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor

CPU = torch.device('cpu')

Reward = Callable[[Moment], Tensor]  # of each shepherd after a step, (B, H)


def team_reward(moment: Moment) -> Tensor:
    """Return the paper's reward, the same for all shepherds of a team, (B, H)."""
    return moment.reward[:, None].expand(moment.state.shepherd_mask.shape)


class WorldGroup:
    """Worlds of one configuration, whose episodes are cut together; some may end before."""

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
        """
        Create the group; begin() starts its first episode. count: with the tally of metrics.

        Its episodes are those of seed and index, which is its own over all processes.
        """
        self.task, self.index, self.n_worlds, self.seed = task, index, n_worlds, seed
        self.lidar, self.count, self.device = lidar, count, device
        self.episode, self.restarts = 0, 0
        self.terms: dict[str, Tensor] = {}  # sums over steps of the mean of each term

    moment: Moment
    left: int  # steps until the episode is cut

    def begin(self, steps: int) -> None:
        """Start an episode of `steps` steps, in a world that is drawn from the task."""
        seeds = mixed_seeds(self.n_worlds, self.seed, self.index, self.episode)
        config = replace(draw_environment(self.task, int(seeds[0])), lidar=self.lidar)
        state = start_of(self.task, config.world, seeds.to(self.device))
        self.moment = start(state, config, self.count)
        self.left, self.episode, self.restarts = steps, self.episode + 1, 0

    def restart(self, ended: Tensor) -> None:
        """Start other episodes of the same configuration where they ended, (B,) bool."""
        self.restarts += 1
        seeds = mixed_seeds(self.n_worlds, self.seed, self.index, self.episode, self.restarts)
        fresh = start_of(self.task, self.moment.config.world, seeds.to(self.device))
        self.moment = restart(self.moment, ended, fresh)

    def state_dict(self) -> dict[str, Any]:
        """Return the number of the episode, how often worlds began anew in it, and its state."""
        world_state = self.moment.state
        state = {f.name: getattr(world_state, f.name) for f in fields(world_state)}
        counts = {'episode': self.episode, 'restarts': self.restarts, 'left': self.left}
        return {**counts, 'state': state}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the state that state_dict() returned."""
        self.episode = state_dict['episode'] - 1
        self.begin(state_dict['left'])
        self.restarts = state_dict['restarts']
        state = {name: t.to(self.device) for name, t in state_dict['state'].items()}
        self.moment = start(WorldState(**state), self.moment.config, self.count)

    def step(self, command: Tensor) -> None:
        """Advance by one step with a command (B, H, 2) m/s."""
        self.moment = advance(self.moment, command)
        self.left -= 1

    def _costs(self, state: WorldState) -> Tensor | float:
        """Return whether a way has a cost in a state, (B, 1), or 1 for everywhere."""
        if self.task.effort_from == 'start':
            return 1.0
        away = torch.linalg.vector_norm(state.center - state.goal, dim=-1)
        return (away <= state.goal_radius)[:, None]

    def hold(self, command: Tensor, repeat: int, reward: Reward) -> Tensor:
        """
        Hold a command (B, H, 2) m/s for some steps; return the sum of the rewards, (B, H).

        A world that ends on the way stays in its terminal state, until restart().
        The cost of a path, `effort`, is each shepherd's own, and no term of its team's reward.
        """
        total, effort = command.new_zeros(command.shape[:-1]), self.task.effort
        for _ in range(repeat):
            self.step(command)
            moment = self.moment
            total += reward(moment)
            terms = moment.reward_terms
            if effort > 0:
                displacement = torch.linalg.vector_norm(
                    moment.state.shepherds - moment.before.shepherds, dim=-1
                )
                cost = effort * displacement * self._costs(moment.before)
                total -= cost
                terms = terms | {'effort': -cost}
            for name, term in terms.items():
                self.terms[name] = self.terms.get(name, 0.0) + term.mean()
        return total
