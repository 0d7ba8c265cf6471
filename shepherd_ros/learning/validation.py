"""Evaluation of a policy in training: whole episodes by its mean action, from fixed starts."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
import math

from shepherd_ros.controllers.policy_controller import LearnedConfig, LearnedController
from shepherd_ros.experiments.runner import run_episodes
from shepherd_ros.learning.task import base_world, TaskConfig
from shepherd_ros.policy.policy import Policy
from shepherd_ros.sim.metrics import shown
from shepherd_ros.sim.rollout import EnvConfig
import torch

VALIDATION_SEED = 900_000_000  # far from those of tables; those of training are mixed, and higher


def validation_sizes(task: TaskConfig) -> list[int]:
    """Return flock sizes to evaluate: a middling one; where doublings count, also the ends."""
    low, high = task.sheep_min, task.sheep_max
    if task.sheep_scale == 'linear':
        return [(low + high) // 2]
    return sorted({low, round(math.sqrt(low * high)), high})


def validate(
    policy: Policy, task: TaskConfig, episodes: int, steps: int, dtype: torch.dtype
) -> dict[str, float]:
    """
    Return means over episodes with 1 to 6 shepherds and the smallest goal of a task.

    `score` is what checkpoints are chosen by: the return, and the fraction in the goal at the end.
    """
    sizes = validation_sizes(task)
    count = max(episodes // (len(task.flocks) * len(sizes)), 1)
    results = []
    for flock, sheep in product(task.flocks, sizes):
        world = base_world(task, flock)
        world = replace(
            world,
            n_sheep=sheep,
            episode_steps=steps,
            spawn=replace(world.spawn, goal_radius_extra=0.0),
        )
        controller = LearnedController(LearnedConfig(), world, policy, dtype)
        config, device = EnvConfig(world=world, reward=task.reward), str(policy.device)
        results.append(run_episodes(config, controller, VALIDATION_SEED, count, device=device))
    means = {
        name: float(torch.cat([result[name] for result in results]).mean())
        for name in ('return', *(metric.name for metric in shown('eval')))
    }
    return means | {'score': means['return'] / 10 + means['fraction_in_goal']}
