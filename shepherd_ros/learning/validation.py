"""Evaluation of a policy in training: whole episodes by its mean action, from fixed starts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
import math

from shepherd_ros.config import Config, option
from shepherd_ros.controllers.policy_controller import LearnedConfig, LearnedController
from shepherd_ros.experiments.runner import run_episodes
from shepherd_ros.learning.task import base_world, TaskConfig
from shepherd_ros.policy.policy import Policy
from shepherd_ros.sim.metrics import shown
from shepherd_ros.sim.rollout import EnvConfig
import torch

VALIDATION_SEED = 900_000_000  # far from those of tables; those of training are mixed, and higher


@dataclass(frozen=True)
class EvaluationConfig(Config):
    """Options of the evaluations by which a training chooses the policy that it keeps."""

    eval_episodes: int = option(32, 'episodes of an evaluation', low=2)
    eval_steps: int = option(1000, 'steps of these episodes', low=1)
    eval_noise: float = option(
        0.0,
        'noise on perceived positions in half of these episodes [m]; 0: in none',
        low=0.0,
    )
    keep_evaluated: bool = option(False, 'keep the policy of each evaluation, not only the best')


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
    Return means over episodes with 1 to 6 shepherds and the smallest goal of a task.

    `score` is what checkpoints are chosen by: the return, and the fraction in the goal at the end.
    """
    sizes = validation_sizes(task)
    noises = (0.0, evaluation.eval_noise) if evaluation.eval_noise else (0.0,)
    cells = list(product(task.flocks, sizes, noises))
    count, results = max(evaluation.eval_episodes // len(cells), 1), []
    for flock, sheep, noise in cells:
        world = base_world(task, flock)
        world = replace(
            world,
            n_sheep=sheep,
            episode_steps=evaluation.eval_steps,
            spawn=replace(world.spawn, goal_radius_extra=0.0),
        )
        controller = LearnedController(LearnedConfig(), world, policy, dtype)
        config, device = (
            EnvConfig(noise_std=noise, world=world, reward=task.reward),
            str(policy.device),
        )
        results.append(run_episodes(config, controller, VALIDATION_SEED, count, device=device))
    means = {
        name: float(torch.cat([result[name] for result in results]).mean())
        for name in ('return', *(metric.name for metric in shown('eval')))
    }
    return means | {'score': means['return'] / 10 + means['fraction_in_goal']}
