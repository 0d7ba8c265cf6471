"""Defaults of a recipe and metrics of its progress, by the task of a training."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

from shepherd_ros.learning.dagger_config import DaggerConfig
from shepherd_ros.learning.task import task_defaults, TaskConfig
from shepherd_ros.learning.train_ppo import PPORunConfig
from shepherd_ros.sim.metrics import shown
from shepherd_ros.sim.tasks import TASKS

R = TypeVar('R')


def other_task(arguments: Any) -> str:
    """Return the task of a training in the simulator, '' if it is that of the defaults."""
    task = getattr(arguments.run_, 'task', None)
    return '' if task is None or task.task == TaskConfig.task else str(task.task)


def for_task(recipe: R, task: str) -> R:
    """Return a recipe with the defaults of a task; cloning takes that of its bags."""
    given: Any = recipe
    run = given.run
    if isinstance(run, PPORunConfig | DaggerConfig):
        run = replace(run, task=task_defaults(run.task, task))
    changed: R = replace(given, policy=replace(given.policy, task=task), run=run)
    return changed


def progress_names() -> list[str]:
    """Return the metrics that progress shows, of all tasks."""
    tasks = TASKS.values()
    return list(dict.fromkeys(m.name for kind in tasks for m in shown('progress', kind.metrics)))
