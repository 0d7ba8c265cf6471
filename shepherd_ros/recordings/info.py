"""Summary of a bag in the form of `ros2 bag info`, with its episodes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
import math
from typing import Any

from shepherd_ros.recordings.grouping import namespaces, RecordedGroups, STATES
from shepherd_ros.rosbag2.bag import Bag
from shepherd_ros.rosbag2.metadata import NO_START, TopicInfo
from shepherd_ros.rosbag2.qos import agreed_policy, duration_ns
from shepherd_ros.wire.topics import GOAL, GOAL_POSES

INDENT = 19  # as in ros2 bag info
_PLAIN = (
    'namespace', 'number', 'seed', 'n_sheep', 'n_shepherds', 'states', 'expected', 'last', 'whole',
)  # fmt: skip


@dataclass(frozen=True)
class EpisodeSummary:
    """An episode of a bag."""

    namespace: str
    number: int
    seed: int
    n_sheep: int
    n_shepherds: int
    states: int  # with poses of both kinds
    expected: int  # states of a whole episode
    last: int  # step of its last state, -1 without any
    values: Mapping[str, float]  # its metrics; {} if not asked for, or if states are unusable
    metrics: list[str]  # for a table; [] if they were not asked for

    @property
    def whole(self) -> bool:
        """Return whether no state is missing."""
        return self.states == self.expected

    def content(self) -> dict[str, Any]:
        """Return the same as plain data for JSON, without metrics where earlier states lack."""
        plain = {name: getattr(self, name) for name in _PLAIN}
        counted = self.values if self.states == self.last + 1 else {}
        values = {k: float(v) if math.isfinite(v) else None for k, v in counted.items()}
        return plain | {'metrics': values}

    @property
    def row(self) -> list[str]:
        """Return the metrics with their part of the episode, none where earlier states lack."""
        if self.whole:
            return [*self.metrics, '']
        if 0 < self.states == self.last + 1:
            return [*self.metrics, f'not whole: until step {self.last}']
        missing = f'{self.expected - self.states} of {self.expected} missing'
        return [*('-' for _ in self.metrics), f'not whole: {missing}']


@dataclass(frozen=True)
class BagInfo:
    """Everything about a bag but its messages; times in ns."""

    files: list[str]
    size: int  # [bytes] of all files
    storage: str
    distro: str
    compression: str  # none, lz4, zstd, or several
    start_ns: int
    end_ns: int
    messages: int
    topics: list[TopicInfo]
    custom_data: dict[str, str]
    episodes: list[EpisodeSummary]
    metrics: list[str]  # short names of the metrics of episodes
    task: str = 'herding'  # of the first episode

    @property
    def duration_ns(self) -> int:
        """Return the time between the first message and the last."""
        return self.end_ns - self.start_ns

    def text(self) -> str:
        """Return the text of `ros2 bag info`, with compression and episodes."""
        rows = [
            ('Files:', self.files),
            ('Bag size:', [size_text(self.size)]),
            ('Storage id:', [self.storage]),
            ('ROS Distro:', [self.distro or 'unknown']),
            ('Compression:', [self.compression]),
            ('Duration:', [f'{_seconds(self.duration_ns)}s']),
            ('Start:', [_time(self.start_ns)]),
            ('End:', [_time(self.end_ns)]),
            ('Messages:', [str(self.messages)]),
            ('Topic information:', [_topic(topic) for topic in self.topics]),
            ('Episodes:', [_episode(episode) for episode in self.episodes]),
        ]
        if self.metrics and self.episodes:
            rows.append(('Metrics:', self._metrics_table()))
        lines = []
        for name, values in rows:
            for i, value in enumerate(values or ['']):
                lines.append(f'{"" if i else name:<{INDENT}}{value}'.rstrip())
        return '\n'.join(lines)

    def content(self) -> dict[str, Any]:
        """Return the same as plain data for JSON: times in ns, sizes in bytes."""
        return {
            'files': self.files,
            'size': self.size,
            'storage': self.storage,
            'distro': self.distro,
            'compression': self.compression,
            'start_ns': self.start_ns,
            'end_ns': self.end_ns,
            'messages': self.messages,
            'topics': [
                {'name': t.name, 'type': t.type, 'count': t.count, 'encoding': t.serialization}
                for t in self.topics
            ],
            'custom_data': self.custom_data,
            'episodes': [episode.content() for episode in self.episodes],
        }

    def _metrics_table(self) -> list[str]:
        """Return a line for each episode, and the means of those that are whole."""
        table = [['episode', 'seed', *self.metrics, '']]
        table += [
            [f'{e.namespace} {e.number}'.strip(), str(e.seed), *e.row] for e in self.episodes
        ]
        if len(whole := self.whole_values) > 1:
            from shepherd_ros.recordings.episode_metrics import mean_texts  # needs torch

            table.append(['mean', f'n={len(whole)}', *mean_texts(whole, self.task), ''])
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        return ['  '.join([*map(str.rjust, row[:-1], widths), row[-1]]).rstrip() for row in table]

    @property
    def whole_values(self) -> list[Mapping[str, float]]:
        """Return the metrics of the episodes that are whole."""
        return [episode.values for episode in self.episodes if episode.whole and episode.values]


def bag_info(bag: Bag, metrics: bool = False) -> BagInfo:
    """Return the summary of a bag, in one pass; raises BagError where its poses cannot be read."""
    if metrics:
        from shepherd_ros.recordings.episode_metrics import (  # need torch
            metrics_heads,
            metrics_of,
            metrics_texts,
        )
    packed = {name or 'none' for storage in bag.storages for name in storage.compressions}
    episodes: list[EpisodeSummary] = []
    task = ''  # of the first episode
    for namespace in namespaces(bag):
        for group in RecordedGroups(
            bag, namespace, (*STATES, GOAL, GOAL_POSES) if metrics else STATES
        ):
            info = group.info
            task = task or info.task
            steps = [step for step, s in group.states.items() if s.sheep and s.shepherds]
            last = max(steps, default=-1)
            values = metrics_of(bag, group) if metrics else {}
            episodes.append(
                EpisodeSummary(
                    namespace=namespace,
                    number=info.number,
                    seed=info.seed,
                    n_sheep=info.n_sheep,
                    n_shepherds=info.n_shepherds,
                    states=len(steps),
                    expected=last + 1 if info.end == 'terminated' else info.episode_steps + 1,
                    last=last,
                    values=values,
                    metrics=metrics_texts(values, task) if metrics else [],
                )
            )
    return BagInfo(
        files=[storage.path.name for storage in bag.storages],
        size=sum(storage.size for storage in bag.storages),
        storage=bag.storage,
        distro=bag.metadata.distro if bag.metadata else '',
        compression=', '.join(sorted(packed)) or 'none',
        start_ns=bag.start_ns,
        end_ns=bag.end_ns,
        messages=bag.count,
        topics=list(bag.topics.values()),
        custom_data=bag.custom_data,
        episodes=episodes,
        metrics=metrics_heads(task or 'herding') if metrics else [],
        task=task or 'herding',
    )


def size_text(size: float) -> str:
    """Return a size [bytes] in a unit for people."""
    for unit in ('B', 'KiB', 'MiB', 'GiB'):
        if size < 1024:
            return f'{size:.0f} B' if unit == 'B' else f'{size:.1f} {unit}'
        size /= 1024
    return f'{size:.1f} TiB'


def _seconds(ns: int) -> str:
    return f'{ns // 10**9}.{ns % 10**9:09d}'


def _time(ns: int) -> str:
    """Return a time of the wall clock, and in seconds since the epoch."""
    try:
        day = datetime.fromtimestamp(ns // 10**9)
    except (OverflowError, OSError, ValueError):  # farther away than the calendar goes
        return f'({_seconds(ns)})'
    clock = f'{day:%H:%M:%S}.{ns % 10**9:09d}'
    return f'{day:%b} {day.day:>2} {day.year} {clock} ({_seconds(ns)})'


def _topic(topic: TopicInfo) -> str:
    names = ('deadline', 'lifespan', 'liveliness', 'liveliness_lease_duration')
    offers = {name: agreed_policy(topic.qos, name) for name in names}
    policies = [
        f'{name.removeprefix("liveliness_").removesuffix("_duration")} '
        + (value if isinstance(value, str) else f'{duration_ns(value) / 1e9:g} s')
        for name, value in offers.items()
        if value != 'automatic' and (isinstance(value, str) or duration_ns(value) < NO_START)
    ]
    return (
        f'Topic: {topic.name} | Type: {topic.type} | Count: {topic.count} | '
        f'Serialization Format: {topic.serialization}'
        + (f' | {", ".join(policies)}' if policies else '')
    )


def _episode(episode: EpisodeSummary) -> str:
    place = f'{episode.namespace} ' if episode.namespace else ''
    return (
        f'{place}Episode: {episode.number} | Seed: {episode.seed} | Sheep: {episode.n_sheep} | '
        f'Shepherds: {episode.n_shepherds} | States: {episode.states} of {episode.expected} | '
        f'{"whole" if episode.whole else "not whole"}'
    )
