"""
Grouping of the messages of a bag into episodes and states, by stamp and not by order of arrival.

An episode is announced by the topic episode. Its states are those whose stamps lie on its grid;
scans and commands carry the stamp of the state that they belong to. A world that is started again
counts stamps from the front again, so log times decide between episodes with the same stamps.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import Any

from shepherd_ros.config import ConfigError
from shepherd_ros.recordings.contents import decode_message
from shepherd_ros.rosbag2.bag import Bag
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS, sorted_channels
from shepherd_ros.wire.contract import known, KnownTopic
from shepherd_ros.wire.decode import Floats, Poses, Ranges, Vector
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.topics import (
    COMMANDS,
    DRIVERS,
    EPISODE,
    GOAL,
    GOAL_POSES,
    scan_topic,
    SHEEP_POSES,
    SHEPHERD_POSES,
)

SCANS = scan_topic('')  # and the name of a channel
STATES = (SHEEP_POSES, SHEPHERD_POSES)
EPISODE_PARTS = (*STATES, SCANS, COMMANDS, GOAL, GOAL_POSES, DRIVERS)
CLOSING_STEP = 2  # an episode ends for good when the next one has a state with this step
TEXT_TYPE = 'std_msgs/msg/String'  # of announcements


@dataclass
class RecordedState:
    """Messages of one state; the first of each topic counts, of drivers the last."""

    sheep: Poses | None = None
    shepherds: Poses | None = None
    goal: Poses | None = None  # the goal and its destination, where it moves
    scans: dict[tuple[int, str], Ranges] = field(default_factory=dict)  # by shepherd, channel
    lidars: set[tuple[float, float]] = field(default_factory=set)  # range_max m, angle_min rad
    commands: dict[int, Floats] = field(default_factory=dict)  # by shepherd
    drivers: tuple[str | None, ...] = ()  # by shepherd, () if not recorded
    raw: dict[str, bytes] = field(default_factory=dict)  # poses and scans by topic, if kept


@dataclass
class RecordedGroup:
    """An episode as it was recorded."""

    info: Episode
    channels: tuple[str, ...] = PAPER_CHANNELS  # of the scans
    states: dict[int, RecordedState] = field(default_factory=dict)  # by step
    goals: list[tuple[int, Floats]] = field(default_factory=list)  # stamp [ns], position (2,) m
    disorder: list[tuple[str, int]] = field(default_factory=list)  # topic, stamp that goes back
    astray: list[tuple[str, int]] = field(default_factory=list)  # topic, stamp between two states
    latest: dict[str, int] = field(default_factory=dict)  # last stamp by topic
    last_step: int = -1  # with poses, -1 if there is none


def namespaces(bag: Bag) -> list[str]:
    """Return the namespaces with episodes: [''] for most bags, [] for those of other projects."""
    topics = [t.name for t in bag.topics.values() if t.count and t.type == TEXT_TYPE]
    entries = [known(name) for name in topics]
    return [entry.namespace for entry in entries if entry and entry.topic.name == EPISODE]


def announced_episodes(bag: Bag, namespace: str) -> list[tuple[int, Episode]]:
    """Return log times [ns] and episodes, with goal_radius 0 if absent; raises BagError."""
    infos = []
    for message in bag.messages([f'{namespace}/{EPISODE}']):
        text = decode_message(bag, message, [TEXT_TYPE])
        try:
            infos.append((message.log_ns, Episode.from_json(text, goal_radius=0.0)))
        except ConfigError as error:
            raise BagError(bag.path, f'{message.topic}: {error}') from error
    return infos


class RecordedGroups:
    """
    The episodes of a namespace in the order of the recording; iterating raises BagError.

    parts are names of the contract that are read; keep: also the bytes of poses and scans; labels:
    the namespace, inside the other one, of the commands that are read instead of the executed
    ones. The episode being read is in memory, and the one before until it is complete.
    """

    def __init__(
        self,
        bag: Bag,
        namespace: str = '',
        parts: Collection[str] = EPISODE_PARTS,
        keep: bool = False,
        labels: str = '',
    ) -> None:
        """Select the topics to read; raises BagError without any command in labels."""
        self.bag, self.namespace, self.keep = bag, namespace, keep
        self.stray: Counter[str] = Counter()  # messages that are of no episode, by topic
        source = f'{namespace}/{labels}' if labels else namespace
        self.topics = {
            name: entry
            for name in bag.topics
            for entry in [known(name)]
            if entry
            and (SCANS if entry.topic.name.startswith(SCANS) else entry.topic.name) in parts
            and entry.namespace == (source if entry.topic.name == COMMANDS else namespace)
        }
        if labels and not any(entry.topic.name == COMMANDS for entry in self.topics.values()):
            raise BagError(
                bag.path,
                f'labels is {labels!r}, but it has no topic {source}/shepherd_<h>/cmd_vel',
                'use labels of a recording that has them, such as those of train dagger '
                '--bag-folder',
            )

    @property
    def channels(self) -> tuple[str, ...]:
        """Return the channels of the scans."""
        names = (
            entry.topic.name for name, entry in self.topics.items() if self.bag.topics[name].count
        )
        return sorted_channels(
            name.removeprefix(SCANS) for name in names if name.startswith(SCANS)
        )

    def __iter__(self) -> Iterator[RecordedGroup]:
        """Yield one episode after another."""
        sorter = _Sorter(announced_episodes(self.bag, self.namespace), self.channels)
        for message in self.bag.messages(self.topics):
            yield from sorter.begin_until(message.log_ns)
            entry = self.topics[message.topic]
            content = decode_message(self.bag, message, entry.types)
            if not sorter.add(entry, content, message.data if self.keep else None):
                self.stray[message.topic] += 1
        yield from sorter.begin_until(2**64)
        yield from sorter.open


class _Sorter:
    """Episodes that may still get messages."""

    def __init__(self, infos: list[tuple[int, Episode]], channels: tuple[str, ...]) -> None:
        self.upcoming, self.channels = list(reversed(infos)), channels
        self.open: list[RecordedGroup] = []  # the present one last
        self.n_unannounced = 0  # of the open ones, how many at the end are not announced yet
        self.last_stamp_ns: int | None = None  # stamp of the latest state
        self.n_goals: int | None = None  # goals when the present episode was announced once more

    def begin_until(self, log_ns: int) -> Iterator[RecordedGroup]:
        """Begin the episodes announced until a log time; yield those that are complete."""
        while self.upcoming and self.upcoming[-1][0] <= log_ns:
            _, info = self.upcoming.pop()
            if self.n_unannounced:
                self.n_unannounced -= 1
                continue
            if self.open and self.open[-1].info == info:
                # said to those who were silent, or of a world started anew
                self.n_goals = len(self.open[-1].goals)
                if info.end:
                    self.open[-1].info = info
                continue
            self.open.append(RecordedGroup(info, self.channels))
            self.n_goals = None
        last = self.open[-1] if self.open else None
        keep = 1 if last is not None and last.last_step >= CLOSING_STEP else 2
        while len(self.open) > keep:
            yield self.open.pop(0)

    def add(
        self, entry: KnownTopic, content: Poses | Vector | Any, raw: bytes | None = None
    ) -> bool:
        """Add a message, and its bytes to keep; return whether it belongs to an episode."""
        name = entry.topic.name
        stamp_ns = self.last_stamp_ns if content.stamp_ns is None else content.stamp_ns
        if name in STATES:
            self.last_stamp_ns = stamp_ns
        group = None if stamp_ns is None else self._group(stamp_ns)
        if group is None or stamp_ns is None:
            return False
        label = name.replace('{h}', str(entry.shepherd))
        goes_back = name in STATES and stamp_ns < group.latest.get(label, 0)
        if goes_back and self.n_goals is not None and group is self.open[-1]:
            self.open.append(
                RecordedGroup(group.info, self.channels, goals=group.goals[self.n_goals :])
            )
            del group.goals[self.n_goals :]
            group, self.n_goals = self.open[-1], None
        if name == GOAL:
            group.goals.append((stamp_ns, content.xy))
            return True
        if stamp_ns < group.latest.get(label, stamp_ns):
            group.disorder.append((label, stamp_ns))
        group.latest[label] = stamp_ns
        step, rest = divmod(stamp_ns - group.info.start_ns, group.info.dt_ns)
        if rest:
            group.astray.append((label, stamp_ns))
            return True
        if name in STATES:
            group.last_step = max(group.last_step, step)
        state = group.states.setdefault(step, RecordedState())
        _store(state, name, entry.shepherd, content)
        if raw is not None and name not in (COMMANDS, DRIVERS):
            state.raw.setdefault(label, raw)
        return True

    def _group(self, stamp_ns: int) -> RecordedGroup | None:
        """Return the episode of a stamp: the present one, one before, or the next one."""
        for group in reversed(self.open):
            if group.info.has(stamp_ns):
                return group
        if self.upcoming and not self.n_unannounced and self.upcoming[-1][1].has(stamp_ns):
            # on its way to the recorder the announcement was overtaken
            self.open.append(RecordedGroup(self.upcoming[-1][1], self.channels))
            self.n_unannounced += 1
            return self.open[-1]
        return None


def _store(state: RecordedState, name: str, shepherd: int | None, content: Any) -> None:
    """Store the content of a message in a state, unless it has that already."""
    if name == SHEEP_POSES:
        state.sheep = state.sheep or content
    elif name == SHEPHERD_POSES:
        state.shepherds = state.shepherds or content
    elif name == GOAL_POSES:
        state.goal = state.goal or content
    elif name == DRIVERS:
        state.drivers = content.drivers
    elif shepherd is not None and name == COMMANDS:
        state.commands.setdefault(shepherd, content.xy)
    elif shepherd is not None:
        state.scans.setdefault((shepherd, name.removeprefix(SCANS)), content.ranges)
        state.lidars.add((round(content.range_max, 3), round(content.angle_min, 5)))
