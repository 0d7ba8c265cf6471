"""Metrics of an episode of a bag, counted from the recorded poses."""

from __future__ import annotations

from shepherd_ros.config import ConfigError
from shepherd_ros.recordings.episodes import episode_of
from shepherd_ros.recordings.grouping import RecordedGroup
from shepherd_ros.recordings.replay import metrics_over_time, states_of
from shepherd_ros.rosbag2.bag import Bag
from shepherd_ros.sim.metrics import shown


def metrics_heads() -> list[str]:
    """Return the short names of the metrics that `bag info` shows."""
    return [metric.short for metric in shown('bag')]


def metrics_of(bag: Bag, group: RecordedGroup) -> list[str]:
    """Return the metrics of an episode after its last state, ? where its states are unusable."""
    names = [metric.name for metric in shown('bag')]
    try:
        episode = episode_of(bag, group)
        if not episode.frames:
            return ['?'] * len(names)
        curves = metrics_over_time(states_of(episode), episode.episode_steps)
    except ConfigError:
        return ['?'] * len(names)
    values = {name: f'{curves[name][-1]:.4g}' for name in names}
    if not curves['completed'][-1]:
        values['completion_time'] = 'never'
    return list(values.values())
