"""Feed of the console from a running graph: newest messages, decoded when they are drawn."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import json
import math
from typing import Any

import numpy as np
from shepherd_ros.config import ConfigError
from shepherd_ros.console.state_frames import NO_DRIVER, NO_SHEPHERD, StateFrame
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.ros.polling import PolledGroup, PolledTopic
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS
from shepherd_ros.wire.decode import (
    CdrError,
    decode_pose_stamped,
    decode_poses,
    decode_scan,
    decode_stamp,
    decode_string,
    Poses,
)
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.topics import (
    EPISODE,
    GOAL,
    scan_topic,
    SHEEP_POSES,
    SHEPHERD_POSES,
)

RECENT = 4  # newest messages of a topic, among which one of the same stamp as others is looked for
Parts = dict[int, bytes]  # newest messages of a topic by stamp [ns]


class ConsoleFeed:
    """
    Newest state of a graph, with the ranges of chosen shepherds.

    No executor hears its subscriptions: each look takes what has come, so that its cost follows
    the rate of the looks and not that of the world.
    """

    def __init__(self, node: ShepherdNode, tell: Callable[..., None]) -> None:
        """Subscribe; tell(kind, **content) hears of what is latched."""
        self.node, self.tell = node, tell
        self.group = PolledGroup()
        self.halves: dict[str, Parts] = {SHEEP_POSES: {}, SHEPHERD_POSES: {}}
        self.inputs = {name: self._topic(name, depth=RECENT) for name in self.halves}
        self.inputs |= {name: self._topic(name) for name in (EPISODE, GOAL)}
        self.scans: dict[int, dict[str, PolledTopic]] = {}
        self.seen: dict[int, dict[str, Parts]] = {}
        self.episode: Episode | None = None
        self.goal: tuple[float, float] | None = None
        self.drivers: list[float] = []  # of each shepherd, index of its source
        self.stamp = -1  # of the newest whole state [ns]
        self.poses: tuple[Poses, Poses] | None = None
        self.fresh = False  # whether something has come that pages have not got

    def _topic(self, name: str, shepherd: int = 0, depth: int = 1) -> PolledTopic:
        return PolledTopic(self.node, self.group, name, shepherd, depth)

    # ---- states ----

    def look(self) -> bool:
        """Take what has come; return whether there is a new state, goal or episode to show."""
        with suppress(CdrError, ConfigError):
            self._hear_latched()
        for name, parts in self.halves.items():
            _keep(parts, self.inputs[name].take())
        common = self.halves[SHEEP_POSES].keys() & self.halves[SHEPHERD_POSES].keys()
        newest = max((ns for ns in common if self._belongs(ns)), default=-1)
        if newest not in (-1, self.stamp):
            self.stamp, self.poses, self.fresh = newest, None, True
        fresh, self.fresh = self.fresh, False
        return fresh and self.stamp >= 0

    def _belongs(self, ns: int) -> bool:
        return self.episode is not None and self.episode.has(ns)

    def _hear_latched(self) -> None:
        for raw in self.inputs[GOAL].take():
            goal = decode_pose_stamped(raw)
            if goal.frame_id == self.node.frame_id and math.isfinite(goal.x + goal.y):
                self.goal, self.fresh = (goal.x, goal.y), True
        for raw in self.inputs[EPISODE].take():
            text = decode_string(raw)
            episode = Episode.from_json(text)
            if episode != self.episode:
                self.episode, self.fresh, self.stamp, self.poses = episode, True, -1, None
                self.tell('episode', **json.loads(text))

    def set_drivers(self, drivers: list[float]) -> None:
        """Take note of who drives each shepherd."""
        if drivers != self.drivers:
            self.drivers, self.fresh = drivers, True

    @property
    def step(self) -> int:
        """Return the step of the newest state, -1 before the first."""
        return -1 if self.episode is None or self.stamp < 0 else self.episode.step_of(self.stamp)

    def decoded(self) -> tuple[Poses, Poses] | None:
        """Return the poses of sheep and shepherds in the newest state, None before the first."""
        if self.poses is None and self.stamp >= 0:
            with suppress(CdrError, KeyError):
                sheep, shepherds = (
                    decode_poses(parts[self.stamp]) for parts in self.halves.values()
                )
                finite = np.isfinite(sheep.xy).all() and np.isfinite(shepherds.xy).all()
                self.poses = (sheep, shepherds) if finite else None
        return self.poses

    def frame(self, shepherd: int) -> bytes | None:
        """Return the newest state with the ranges of a shepherd, None before the first."""
        poses, episode = self.decoded(), self.episode
        if poses is None or episode is None or self.goal is None:
            return None
        sheep, shepherds = poses
        team = len(shepherds.xy)
        drivers = self.drivers if len(self.drivers) == team else [NO_DRIVER] * team
        return StateFrame(
            time=self.stamp * 1e-9,
            episode=episode.number,
            step=episode.step_of(self.stamp),
            sheep=sheep.xy,
            sheep_heading=sheep.heading,
            shepherds=shepherds.xy,
            shepherd_heading=shepherds.heading,
            driver=drivers,
            goal=self.goal,
            goal_radius=episode.goal_radius,
            **self._ranges(shepherd, shepherds),
        ).encode()

    def moment(self, shepherd: int) -> dict[str, Any] | None:
        """Return the newest state as plain data, None without one that has the shepherd."""
        poses, episode = self.decoded(), self.episode
        if poses is None or episode is None or self.goal is None:
            return None
        sheep, shepherds = poses
        return (
            None
            if shepherd >= len(shepherds.xy)
            else {
                'step': self.step,
                'sheep': sheep.xy.tolist(),
                'shepherds': shepherds.xy.tolist(),
                'goal': self.goal,
                'goal_radius': episode.goal_radius,
            }
        )

    # ---- lidars ----

    def watch(self, shepherds: set[int]) -> None:
        """Hear the lidars of these shepherds and of no others; in the executor's thread."""
        for h in self.scans.keys() - shepherds:
            self.seen.pop(h, None)
            for topic in self.scans.pop(h).values():
                topic.close()
        for h in shepherds - self.scans.keys():
            self.seen[h] = {channel: {} for channel in PAPER_CHANNELS}
            self.scans[h] = {
                channel: self._topic(scan_topic(channel), h, RECENT) for channel in PAPER_CHANNELS
            }

    def _ranges(self, shepherd: int, shepherds: Poses) -> dict[str, Any]:
        """Return the newest ranges of a shepherd as parts of a frame, {} without any."""
        topics, seen = self.scans.get(shepherd), self.seen.get(shepherd)
        if topics is None or seen is None or not shepherd < len(shepherds.xy):
            return {'lidar': NO_SHEPHERD}
        for channel, topic in topics.items():
            _keep(seen[channel], topic.take())
        stamps = set.intersection(*(set(parts) for parts in seen.values()))
        stamps = {ns for ns in stamps if self._belongs(ns) and ns <= self.stamp}
        if not stamps:
            return {'lidar': NO_SHEPHERD}
        ns, origin = max(stamps), shepherds.xy[shepherd]
        with suppress(CdrError, ValueError):
            ranges = np.stack([decode_scan(parts[ns]).ranges for parts in seen.values()])
            if ns != self.stamp and ns in self.halves[SHEPHERD_POSES]:
                origin = decode_poses(self.halves[SHEPHERD_POSES][ns]).xy[shepherd]
            return {'lidar': shepherd, 'ranges': ranges, 'origin': tuple(origin.tolist())}
        return {'lidar': NO_SHEPHERD}


def _keep(parts: Parts, messages: list[bytes]) -> None:
    """Put messages to those that are kept of a topic, by stamp, and drop older ones."""
    for raw in messages[-RECENT:]:
        with suppress(CdrError):
            parts.pop(ns := decode_stamp(raw), None)
            parts[ns] = raw
    while len(parts) > RECENT:
        del parts[next(iter(parts))]
