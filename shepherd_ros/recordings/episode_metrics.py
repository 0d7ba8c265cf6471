"""Metrics of an episode of a bag, counted from the recorded poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from shepherd_ros.config import ConfigError
from shepherd_ros.recordings.episodes import episode_of
from shepherd_ros.recordings.grouping import RecordedGroup
from shepherd_ros.recordings.replay import metrics_over_time, states_of, task_of
from shepherd_ros.rosbag2.bag import Bag
from shepherd_ros.sim.metrics import Metric, METRICS, shown
from shepherd_ros.sim.tasks import TASKS


def metrics_heads(task: str) -> list[str]:
    """Return the short names of the metrics that `bag info` shows."""
    return [metric.short for metric in shown('bag', _metrics(task))]


def _metrics(task: str) -> Mapping[str, Metric]:
    """Return the metrics of a task; those of herding if it is not known here."""
    return TASKS[task].metrics if task in TASKS else METRICS


def metrics_of(bag: Bag, group: RecordedGroup) -> dict[str, float]:
    """Return the metrics of an episode after its last state, {} where its states are unusable."""
    try:
        episode = episode_of(bag, group)
        if not episode.frames:
            return {}
        task = task_of(episode)
        curves = metrics_over_time(states_of(episode), episode.episode_steps, task)
    except ConfigError:
        return {}
    return {name: float(values[-1]) for name, values in curves.items()}


def metrics_texts(values: Mapping[str, float], task: str) -> list[str]:
    """Return the metrics of an episode for a table, ? where they are not known."""
    texts = {metric.name: '?' for metric in shown('bag', _metrics(task))}
    texts |= {name: f'{values[name]:.4g}' for name in texts if name in values}
    if values and not values.get('completed', 1.0):
        texts['completion_time'] = 'never'
    return list(texts.values())


def mean_texts(episodes: Sequence[Mapping[str, float]], task: str) -> list[str]:
    """Return the means over episodes; one that is never completed counts with its length."""
    names = [metric.name for metric in shown('bag', _metrics(task))]
    return [f'{sum(values[name] for values in episodes) / len(episodes):.4g}' for name in names]
