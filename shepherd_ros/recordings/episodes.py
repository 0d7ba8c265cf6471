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
    """One state of the world, with the scans and the commands of the shepherds."""

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
    drivers: tuple[str | None, ...] = ()  # source of each command, () if nobody said
    destination: Floats | None = None  # (2,) m, None if the goal stands


@dataclass(frozen=True)
class RecordedEpisode(Episode):
    """An episode with all states that were recorded in full."""

    frames: list[Frame] = field(default_factory=list)
    channels: tuple[str, ...] = PAPER_CHANNELS  # of the scans

    @cached_property
    def whole(self) -> bool:
        """Return whether all states were recorded."""
        last = self.episode_steps
        if self.end == 'terminated' and self.frames:
            last = self.frames[-1].step
        return [frame.step for frame in self.frames] == list(range(last + 1))


def one_namespace(bag: Bag, namespace: str | None) -> str:
    """Return the namespace, by default the only one of the bag; raises BagError."""
    spaces = namespaces(bag)
    if namespace is None and len(spaces) == 1:
        return spaces[0]
    if not spaces:
        raise BagError(bag.path, 'it tells of no episode', 'record the topic episode too')
    if namespace not in spaces:
        raise BagError(
            bag.path, f'namespace is {namespace!r}', f'expected one of {spaces}, as in its topics'
        )
    return namespace


def iter_episodes(
    bag: Bag, namespace: str | None = None, labels: str = ''
) -> Iterator[RecordedEpisode]:
    """
    Yield the episodes of a bag in the order of the recording; raises BagError.

    States without poses of both kinds are left out: check_bag() reports them. The commands are
    those in namespace labels, inside the other one; the executed ones if it is empty.
    """
    for group in RecordedGroups(bag, one_namespace(bag, namespace), labels=labels):
        yield episode_of(bag, group)


def episode_of(bag: Bag, group: RecordedGroup) -> RecordedEpisode:
    """Return a recorded episode as arrays; raises BagError where its counts are wrong."""
    info = group.info
    goals = sorted(group.goals, key=lambda goal: goal[0])
    goal_stamps = [stamp_ns for stamp_ns, _ in goals]
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
        index = bisect_right(goal_stamps, stamp_ns)
        goal, destination = (goals[index - 1][1] if index else None), None
        if state.goal is not None and len(state.goal.xy) == 2:
            goal, destination = state.goal.xy
        frames.append(
            Frame(
                stamp_ns=stamp_ns,
                step=step,
                sheep=state.sheep.xy,
                sheep_heading=state.sheep.heading,
                shepherds=state.shepherds.xy,
                shepherd_heading=state.shepherds.heading,
                goal=goal,
                scans=[_scan(bag, group, step, state, h) for h in range(info.n_shepherds)],
                commands=[_command(state, h) for h in range(info.n_shepherds)],
                lidars=frozenset(state.lidars),
                drivers=state.drivers,
                destination=destination,
            )
        )
    values = {f.name: getattr(info, f.name) for f in fields(info)}
    return RecordedEpisode(**values, frames=frames, channels=group.channels)


def _command(state: RecordedState, shepherd: int) -> Floats | None:
    """Return a command (2,) m/s; zero where a lock took back what was commanded before."""
    command, drivers = state.commands.get(shepherd), state.drivers
    if command is not None and len(drivers) > shepherd and drivers[shepherd] is None:
        return np.zeros_like(command)
    return command


def _scan(
    bag: Bag, group: RecordedGroup, step: int, state: RecordedState, shepherd: int
) -> Ranges | None:
    """Return the channels of a scan (C, R) m, None unless all are there."""
    rows = [state.scans.get((shepherd, channel)) for channel in group.channels]
    present = [row for row in rows if row is not None]
    if len(present) < len(rows):
        return None
    if len({len(row) for row in present}) > 1:
        raise BagError(
            bag.path,
            f'episode {group.info.number}, step {step}, shepherd_{shepherd}: channels of '
            f'{[len(row) for row in present]} rays, expected as many in each',
            'record one lidar for each shepherd',
        )
    return np.stack(present)
