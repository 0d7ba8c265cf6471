"""Evaluation of a policy in training: whole episodes from fixed starts, and a score of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
import math

from shepherd_ros.config import Config, ConfigError, option
from shepherd_ros.controllers.policy_controller import LearnedConfig, LearnedController
from shepherd_ros.experiments.runner import run_episodes
from shepherd_ros.learning.task import base_world, TaskConfig
from shepherd_ros.policy.policy import Policy
from shepherd_ros.sim.metrics import shown
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.tasks import TASKS
from shepherd_ros.sim.tasks.herding import Herding
import torch

VALIDATION_SEED = 900_000_000  # far from those of tables; those of training are mixed, and higher

TIME_95 = 'completion_time_95'


@dataclass(frozen=True)
class EvaluationConfig(Config):
    """Options of the evaluations by which a training chooses the policy that it keeps."""

    eval_episodes: int = option(32, 'episodes of an evaluation', low=2)
    eval_steps: int = option(1000, 'steps of these episodes', low=1)
    eval_noise: float = option(
        0.0,
        'noise of positions in half of them [m]; 0: none',
        low=0.0,
    )
    eval_sheep: str = option('', 'sizes of flocks, such as 20,100; empty: as the task')
    eval_shepherds: str = option('', 'sizes of teams, such as 1,3,6; empty: all')
    eval_sample_std: float = option(
        0.0,
        'half by samples of this deviation [m/s]; 0: none',
        low=0.0,
        high=10.0,
    )
    return_weight: float = option(1.0, 'weight of a tenth of the return in the score')
    goal_weight: float = option(1.0, 'weight of the share in the goal in the score')
    time_weight: float = option(
        0.0,
        'weight of late completions, 95th percentile',
        low=0.0,
    )
    path_weight: float = option(0.0, 'weight of 100 m of a path', low=0.0)
    keep_evaluated: bool = option(False, 'keep the policy of each evaluation, not only the best')

    def __post_init__(self) -> None:
        """Check each field and the lists of sizes."""
        super().__post_init__()
        for name in ('eval_sheep', 'eval_shepherds'):
            self.sizes(name)

    def sizes(self, name: str) -> list[int]:
        """Return the sizes that an option lists, or raise ConfigError."""
        words = [word.strip() for word in str(getattr(self, name)).split(',') if word.strip()]
        if not all(word.isascii() and word.isdecimal() and int(word) for word in words):
            raise ConfigError(
                f'{name} is {getattr(self, name)!r}: expected numbers from 1 with commas between '
                'them, such as 1,3,6'
            )
        return [int(word) for word in words]

    def score(self, results: Mapping[str, float], achieved: str = Herding.achieved) -> float:
        """Return what policies are compared by, from the results of an evaluation."""
        gained = (
            self.return_weight * (results['return'] / 10) + self.goal_weight * results[achieved]
        )
        time = results.get(TIME_95, 0.0) / self.eval_steps
        path = results.get('shepherd_path_length', 0.0) / 100
        return gained - self.time_weight * time - self.path_weight * path


def validation_sizes(task: TaskConfig) -> list[int]:
    """Return flock sizes to evaluate: a middling one; where doublings count, also the ends."""
    low, high = task.sheep_min, task.sheep_max
    if task.sheep_scale == 'linear':
        return [(low + high) // 2]
    return sorted({low, round(math.sqrt(low * high)), high})


def validate(
    policy: Policy, task: TaskConfig, evaluation: EvaluationConfig, dtype: torch.dtype
) -> dict[str, float]:
    """
    Return means over episodes with the teams and the smallest goal of a task.

    Each combination of flock model, size, team, noise and way of acting has as many of them.
    `score` is what checkpoints are chosen by; completion_time_95 is the 95th percentile, in which
    an episode that never completes counts as long as it is.
    """
    sizes, kind = evaluation.sizes('eval_sheep') or validation_sizes(task), TASKS[task.task]
    teams = evaluation.sizes('eval_shepherds') or [0]
    noises = (0.0, evaluation.eval_noise) if evaluation.eval_noise else (0.0,)
    spreads = (0.0, evaluation.eval_sample_std) if evaluation.eval_sample_std else (0.0,)
    cells = list(product(task.flocks, sizes, teams, noises, spreads))
    count, results = max(evaluation.eval_episodes // len(cells), 1), []
    for flock, sheep, team, noise, std in cells:
        world = base_world(task, flock)
        if team:
            spawn = replace(world.spawn, fewest_shepherds=0)
            world = replace(world, spawn=spawn, n_shepherds=team)
        world = replace(
            world,
            n_sheep=sheep,
            episode_steps=evaluation.eval_steps,
            spawn=replace(world.spawn, goal_radius_extra=0.0),
        )
        controller = LearnedController(LearnedConfig(sample_std=std), world, policy, dtype)
        config, device = (
            EnvConfig(noise_std=noise, world=world, reward=task.reward),
            str(policy.device),
        )
        results.append(run_episodes(config, controller, VALIDATION_SEED, count, device=device))
    names = ('return', *(metric.name for metric in shown('eval', kind.metrics)))
    whole = {name: torch.cat([result[name] for result in results]) for name in names}
    means = {name: float(values.mean()) for name, values in whole.items()}
    if 'completion_time' in kind.metrics:
        times = torch.cat([result['completion_time'] for result in results])
        means[TIME_95] = float(times.float().quantile(0.95))
    return means | {'score': evaluation.score(means, kind.achieved)}
