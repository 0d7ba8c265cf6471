"""What the console shows of a running graph: newest messages, decoded when they are drawn."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import json
import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from rclpy.serialization import deserialize_message
from shepherd_ros.config import ConfigError
from shepherd_ros.console.frames import NO_DRIVER, NO_SHEPHERD, StateFrame
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.ros.polling import PolledGroup, PolledTopic
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS
from shepherd_ros.wire.contract import known
from shepherd_ros.wire.decode import (
    CdrError,
    decode_float64,
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
    metric_topic,
    row_of,
    scan_topic,
    SHEEP_POSES,
    SHEPHERD_POSES,
)

KEPT = 4  # newest messages of a topic, among which one of the same stamp as others is looked for
FAMILY = metric_topic('').rstrip('/')
DIAGNOSTICS_KEPT = 64  # messages on /diagnostics between two looks
SILENT_NODE = 10.0  # [s] after which the report of a node is left out
Parts = dict[int, bytes]  # newest messages of a topic by stamp [ns]


class ConsoleFeed:
    """
    Newest state, ranges, metrics and reports of a graph.

    No executor hears its subscriptions: each look takes what has come, so that its cost follows
    the rate of the looks and not that of the world.
    """

    def __init__(self, node: ShepherdNode, tell: Callable[..., None]) -> None:
        """Subscribe; tell(kind, **content) hears of what is latched."""
        self.node, self.tell = node, tell
        self.group = PolledGroup()
        self.halves: dict[str, Parts] = {SHEEP_POSES: {}, SHEPHERD_POSES: {}}
        self.inputs = {name: self._topic(name, depth=KEPT) for name in self.halves}
        self.inputs |= {name: self._topic(name) for name in (EPISODE, GOAL)}
        self.reports = self._topic('/diagnostics', depth=DIAGNOSTICS_KEPT)
        self.scans: dict[int, dict[str, PolledTopic]] = {}
        self.seen: dict[int, dict[str, Parts]] = {}
        self.metrics: dict[str, PolledTopic] = {}
        self.values: dict[str, float] = {}
        self.statuses: dict[str, tuple[float, dict[str, Any]]] = {}
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
                self.values.clear()
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
                channel: self._topic(scan_topic(channel), h, KEPT) for channel in PAPER_CHANNELS
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

    # ---- metrics and reports ----

    def look_for_metrics(self) -> None:
        """Subscribe to the metrics that are published; in the executor's thread."""
        space = self.node.get_namespace().rstrip('/')
        for name, _ in self.node.get_topic_names_and_types():
            ours = known(name)
            if ours is None or ours.namespace != space:
                continue
            family, _, metric = ours.topic.name.partition('/')
            if family == FAMILY and metric not in self.metrics:
                self.metrics[metric] = self._topic(ours.topic.name)

    def metric_names(self) -> list[dict[str, str]]:
        """Return name, unit and meaning of each metric that is published."""
        rows = {name: row_of(metric_topic(name)) for name in sorted(self.metrics)}
        return [{'name': n, 'unit': r.unit, 'meaning': r.meaning} for n, r in rows.items()]

    def hear_metrics(self) -> bool:
        """Take the newest metrics; return whether there are any."""
        heard = False
        for name, topic in list(self.metrics.items()):
            for raw in topic.take()[-1:]:
                with suppress(CdrError):
                    value = decode_float64(raw)
                    if math.isfinite(value):
                        self.values[name], heard = value, True
        return heard

    def hear_reports(self) -> list[dict[str, Any]]:
        """Return the newest report of each part of each node, sorted by name."""
        now = self.node.wall()
        for raw in self.reports.take():
            for status in deserialize_message(raw, DiagnosticArray).status:
                self.statuses[status.name] = (
                    now,
                    {
                        'name': status.name,
                        'level': status.level[0],
                        'message': status.message,
                        'values': {item.key: item.value for item in status.values},
                    },
                )
        for name in [n for n, (then, _) in self.statuses.items() if now - then > SILENT_NODE]:
            del self.statuses[name]
        return [report for _, (_, report) in sorted(self.statuses.items())]


def _keep(parts: Parts, messages: list[bytes]) -> None:
    """Put messages to those that are kept of a topic, by stamp, and drop older ones."""
    for raw in messages[-KEPT:]:
        with suppress(CdrError):
            parts.pop(ns := decode_stamp(raw), None)
            parts[ns] = raw
    while len(parts) > KEPT:
        del parts[next(iter(parts))]
