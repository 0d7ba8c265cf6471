"""The lidar node: poses in, a scan of each channel per shepherd out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from shepherd_ros.config import ConfigError
from shepherd_ros.ros.intra_process import Output
from shepherd_ros.ros.markers import ray_markers
from shepherd_ros.ros.node import ERROR, OK, ShepherdNode, WARN
from shepherd_ros.ros.parameters import declare_config
from shepherd_ros.ros.runtime import run
from shepherd_ros.ros.world_subscriber import Listener
from shepherd_ros.sim import compiled
from shepherd_ros.sim.lidar import LidarConfig, scan
from shepherd_ros.sim.perception import perceive
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.tasks import Task
from shepherd_ros.sim.tasks.herding import Herding
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.wire.encode import encode_scan
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.topics import scan_topic
import torch

_ALL = -1  # in shepherd_ids
RAY_MARKER_PERIOD = 0.05  # [s] wall time between two pictures


class LidarNode(ShepherdNode):
    """Casts the rays of one shepherd, or of several, for every state of the world."""

    def __init__(self, **kwargs: Any) -> None:
        """Create the node and its publishers."""
        compiled.start_numba()
        super().__init__('lidar', **kwargs)
        self.config = declare_config(self, LidarConfig())
        self.shepherd_ids: list[int] = self.option(
            'shepherd_ids', [0], 'shepherds that carry it; [-1]: all of the episode'
        )
        ids = self.shepherd_ids
        if ids != [_ALL] and (min(ids) < 0 or len(set(ids)) < len(ids)):
            raise ConfigError(
                f'shepherd_ids is {ids}: expected each shepherd once, counted from 0, such as '
                '[0, 1, 2], or [-1] for all'
            )
        self.scan_frame: str = self.option(
            'scan_frame',
            self.shepherd_frame,
            'frame of the scans, {h} is the index of the shepherd',
        )
        self.noise_std: float = self.option(
            'noise_std', 0.0, 'noise on all perceived positions [m]', low=0.0
        )
        self.outputs: dict[int, list[Output]] = {}
        self._advertise([] if ids == [_ALL] else ids)
        self.markers = self.advertise('markers')
        self.present: list[int] = []
        self.sensors = torch.tensor(self.present)
        self.last_markers = 0.0
        self.task: Task = Herding()
        self.listener = Listener(self, self.on_state, self.on_episode)

    def on_episode(self, episode: Episode, world: WorldConfig) -> None:
        """Select the shepherds of the node that the episode has."""
        self.task = world.task
        team = range(episode.n_shepherds)
        ids = list(team) if self.shepherd_ids == [_ALL] else self.shepherd_ids
        self.present = [h for h in ids if h in team]
        self.sensors = torch.tensor(self.present, dtype=torch.int64)
        self._advertise(ids)
        if self.present != ids:
            missing = sorted(set(ids) - set(self.present))
            self.get_logger().error(
                f'shepherd_ids has {missing}: expected 0 to {episode.n_shepherds - 1}, '
                'as this episode has no others; they get no scans'
            )

    def _advertise(self, shepherds: Sequence[int]) -> None:
        """Publish the scans of these shepherds and of no others."""
        for h in self.outputs.keys() - set(shepherds):
            for output in self.outputs.pop(h):
                self.destroy_publisher(output)
        for h in [h for h in shepherds if h not in self.outputs]:
            channels = self.config.layout.channels
            self.outputs[h] = [self.advertise(scan_topic(channel), h) for channel in channels]

    def on_state(self, ns: int, state: WorldState, episode: Episode) -> None:
        """Publish the scans of a state."""
        if not self.present:
            return
        perceived = self.task.observed(perceive(state, self.noise_std))
        ranges = scan(perceived, self.config, self.sensors).numpy()
        draw = self.wall() - self.last_markers > RAY_MARKER_PERIOD
        for row, h in zip(ranges, self.present, strict=True):
            frame = self.scan_frame.replace('{h}', str(h))
            for output, channel in zip(self.outputs[h], row, strict=True):
                output.publish(encode_scan(ns, frame, channel, self.config.range_max, episode.dt))
            if draw and self.markers.get_subscription_count():
                origin, ranges_of_h = state.shepherds[h], torch.from_numpy(row)
                by_channel = dict(zip(self.config.layout.channels, ranges_of_h, strict=True))
                self.markers.publish(ray_markers(ns, self.frame_id, h, origin, by_channel))
        if draw:
            self.last_markers = self.wall()

    def diagnose(self) -> list[DiagnosticStatus]:
        """Return the status of the lidar: whether states arrive and the shepherds exist."""
        level, message = OK, 'scanning'
        if silence := self.listener.silence():
            level, message = WARN, silence
        elif self.present != list(self.outputs):
            level, message = ERROR, 'some shepherds are not in this episode'
        return [
            self.status(
                'lidar',
                level,
                message,
                states=self.listener.states,
                shepherds=self.present,
                rays=self.config.n_rays,
            )
        ]


def main() -> int:
    """Run the lidar of one shepherd, or of several by parameter shepherd_ids."""
    return run(LidarNode, 'lidar', main.__doc__ or '')
