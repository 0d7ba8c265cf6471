"""A node that collects an episode: states, one shepherd's scans, and the published metrics."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

import numpy as np
import rclpy
from shepherd_ros.config import ConfigError
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.ros.runtime import init_rclpy, make_executor
from shepherd_ros.ros.world_subscriber import Listener
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS
from shepherd_ros.sim.state import stack, WorldState
from shepherd_ros.sim.tasks import TASKS
from shepherd_ros.wire.decode import Scan
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.topics import EPISODE, metric_topic, scan_topic


class EpisodeProbe(ShepherdNode):
    """Subscribes to the topics of a stack and stores those of the first episode."""

    backlog = 10_000  # it has more topics than other nodes and may be slower than the stack

    def __init__(self, shepherd: int = 0, task: str = 'herding', **kwargs: Any) -> None:
        """Subscribe to states, metrics of a task, and the scans of one shepherd."""
        super().__init__('episode_probe', **kwargs)
        self.shepherd = shepherd
        self.episode: Episode | None = None
        self.step = -1  # newest step heard
        self.states: dict[int, WorldState] = {}
        self.scans: dict[int, dict[int, np.ndarray]] = {}
        self.metrics: dict[str, float] = {}
        self.names = list(TASKS[task].metrics)
        self.outcome = ''  # how the episode has ended, where its task has several ends
        self.listener = Listener(self, self.on_state)
        self.listen(EPISODE, self.on_episode)
        for k, channel in enumerate(PAPER_CHANNELS):
            self.listen(scan_topic(channel), partial(self.on_scan, k), shepherd)
        for name in self.names:
            self.listen(metric_topic(name), partial(self.on_metric, name))

    def on_state(self, ns: int, state: WorldState, episode: Episode) -> None:
        """Store a state of the first episode."""
        self.episode = self.episode or episode
        if self.episode.number == episode.number:
            self.states[ns] = state
            self.step = int(state.step)

    def on_episode(self, text: str) -> None:
        """Store how the episode has ended."""
        with suppress(ConfigError):
            episode = Episode.from_json(text)
            if self.episode == episode:
                self.outcome = episode.end

    def on_scan(self, channel: int, scan: Scan) -> None:
        """Store the ranges of one channel."""
        self.scans.setdefault(scan.stamp_ns, {})[channel] = scan.ranges

    def on_metric(self, name: str, value: float) -> None:
        """Store the newest value of a metric."""
        self.metrics[name] = value

    @property
    def is_complete(self) -> bool:
        """Return whether states, scans and all metrics have arrived."""
        return bool(self.states and self.scans and len(self.metrics) == len(self.names))

    def trajectory(self) -> tuple[np.ndarray, WorldState]:
        """Return the stamps (T,) s and the states (T) of the episode, in order of time."""
        order = sorted(self.states)
        return np.array(order) * 1e-9, stack([self.states[ns] for ns in order])

    def ranges(self) -> np.ndarray:
        """Return the shepherd's ranges (T, 3, R) m for each state; inf for a missing scan."""
        first_scan = next(iter(self.scans.values()), {0: np.full(1, np.inf, np.float32)})
        free = np.full_like(next(iter(first_scan.values())), np.inf)
        rows = [
            [self.scans.get(ns, {}).get(k, free) for k in range(len(PAPER_CHANNELS))]
            for ns in sorted(self.states)
        ]
        return np.array(rows)


@contextmanager
def open_episode_probe(
    shepherd: int = 0, task: str = 'herding'
) -> Iterator[tuple[EpisodeProbe, Callable[[float], None]]]:
    """Yield a probe and a function that spins it for at most some time [s]."""
    init_rclpy()
    node = EpisodeProbe(shepherd, task)
    executor = make_executor('events')
    executor.add_node(node)
    try:
        yield node, lambda seconds: executor.spin_once(timeout_sec=seconds)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
