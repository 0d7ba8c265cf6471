"""The metrics of the episodes of a bag, a line for each."""

from __future__ import annotations

from shepherd_ros.config import ConfigError
from shepherd_ros.recordings.episodes import episode_of
from shepherd_ros.recordings.grouping import namespaces, RecordedGroup, RecordedGroups, STATES
from shepherd_ros.recordings.info import INDENT
from shepherd_ros.recordings.replay import metrics_over_time, states_of
from shepherd_ros.rosbag2.reader import Bag
from shepherd_ros.sim.metrics import shown
from shepherd_ros.wire.topics import GOAL


def metrics_lines(bag: Bag) -> list[str]:
    """Return a table for a terminal, counted from the recorded poses; [] without episodes."""
    rows = [['episode', 'seed', *(metric.short for metric in shown('bag'))]]
    for namespace in namespaces(bag):
        for group in RecordedGroups(bag, namespace, (*STATES, GOAL)):
            name = f'{namespace} {group.info.number}'.strip()
            rows.append([name, str(group.info.seed), *_values(bag, group)])
    if len(rows) == 1:
        return []
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ['  '.join(map(str.rjust, row, widths)) for row in rows]
    return [f'{"" if i else "Metrics:":<{INDENT}}{line}' for i, line in enumerate(lines)]


def _values(bag: Bag, group: RecordedGroup) -> list[str]:
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
