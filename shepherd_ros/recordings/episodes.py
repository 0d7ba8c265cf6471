"""The episodes of a bag as arrays, one in memory at a time."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np
from shepherd_ros.recordings.grouping import (
    namespaces,
    RecordedGroup,
    RecordedGroups,
    RecordedState,
)
from shepherd_ros.rosbag2.bag import Bag
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS
from shepherd_ros.wire.decode import Floats, Ranges
from shepherd_ros.wire.episode import Episode


@dataclass(frozen=True)
class Frame:
    """One state of the world, what the shepherds saw of it and what they answered."""

    stamp_ns: int
    step: int
    sheep: Floats  # (N, 2) m
    sheep_heading: Floats  # (N, 2) unit vectors
    shepherds: Floats  # (H, 2) m
    shepherd_heading: Floats  # (H, 2) unit vectors, direction of the last move
    goal: Floats | None  # (2,) m, None if it was not recorded
    scans: list[Ranges | None]  # for each shepherd (C, R) m, +inf for no return
    commands: list[Floats | None]  # for each shepherd (2,) m/s
    lidars: frozenset[tuple[float, float]] = frozenset()  # range_max m, angle_min rad of scans


@dataclass(frozen=True)
class RecordedEpisode(Episode):
    """An episode with all states that were recorded in full."""

    frames: list[Frame] = field(default_factory=list)
    channels: tuple[str, ...] = PAPER_CHANNELS  # of the scans

    @cached_property
    def whole(self) -> bool:
        """Return whether no state is missing."""
        return [frame.step for frame in self.frames] == list(range(self.episode_steps + 1))


def one_namespace(bag: Bag, namespace: str | None) -> str:
    """Return the namespace asked for, or the only one; raises BagError."""
    known = namespaces(bag)
    if namespace is None and len(known) == 1:
        return known[0]
    if not known:
        raise BagError(bag.path, 'it tells of no episode', 'record the topic episode too')
    if namespace not in known:
        raise BagError(
            bag.path, f'namespace is {namespace!r}', f'expected one of {known}, as in its topics'
        )
    return namespace


def iter_episodes(
    bag: Bag, namespace: str | None = None, labels: str = ''
) -> Iterator[RecordedEpisode]:
    """
    Yield the episodes of a bag in the order of the recording; raises BagError.

    States without poses of both kinds are left out: check_bag() tells of them. The commands are
    those in namespace labels, inside the other one; those that were driven if it is empty.
    """
    for group in RecordedGroups(bag, one_namespace(bag, namespace), labels=labels):
        yield episode_of(bag, group)


def episode_of(bag: Bag, group: RecordedGroup) -> RecordedEpisode:
    """Return a recorded episode as arrays; raises BagError where its counts are wrong."""
    info = group.info
    goals = sorted(group.goals, key=lambda goal: goal[0])
    since = [stamp_ns for stamp_ns, _ in goals]
    frames = []
    for step, state in sorted(group.states.items()):
        if state.sheep is None or state.shepherds is None:
            continue
        stamp_ns = info.start_ns + step * info.dt_ns
        sizes = len(state.sheep.xy), len(state.shepherds.xy)
        if sizes != (info.n_sheep, info.n_shepherds):
            raise BagError(
                bag.path,
                f'episode {info.number}, step {step}: {sizes[0]} sheep and {sizes[1]} shepherds, '
                f'expected {info.n_sheep} and {info.n_shepherds}',
                'record one world at a time',
            )
        place = bisect_right(since, stamp_ns)
        frames.append(
            Frame(
                stamp_ns=stamp_ns,
                step=step,
                sheep=state.sheep.xy,
                sheep_heading=state.sheep.heading,
                shepherds=state.shepherds.xy,
                shepherd_heading=state.shepherds.heading,
                goal=goals[place - 1][1] if place else None,
                scans=[_scan(bag, group, step, state, h) for h in range(info.n_shepherds)],
                commands=[state.commands.get(h) for h in range(info.n_shepherds)],
                lidars=frozenset(state.lidars),
            )
        )
    about = {f.name: getattr(info, f.name) for f in fields(info)}
    return RecordedEpisode(**about, frames=frames, channels=group.channels)


def _scan(
    bag: Bag, group: RecordedGroup, step: int, state: RecordedState, shepherd: int
) -> Ranges | None:
    """Return the channels of a scan (C, R) m, None unless all are there."""
    rows = [state.scans.get((shepherd, channel)) for channel in group.channels]
    there = [row for row in rows if row is not None]
    if len(there) < len(rows):
        return None
    if len({len(row) for row in there}) > 1:
        raise BagError(
            bag.path,
            f'episode {group.info.number}, step {step}, shepherd_{shepherd}: channels of '
            f'{[len(row) for row in there]} rays, expected as many in each',
            'record one lidar for each shepherd',
        )
    return np.stack(there)
