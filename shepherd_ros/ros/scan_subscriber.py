"""Subscriber of the lidars: scans of each shepherd, put together by stamp."""

from __future__ import annotations

from collections.abc import Callable
import math

import numpy as np
from rclpy.subscription import Subscription
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.wire.decode import Scan
from shepherd_ros.wire.topics import scan_topic, SHEPHERD

SCAN_WARNING_PERIOD = 5.0  # [s] between two warnings
ANGLE_SLACK = 0.1  # by how much of the angle between two rays the last may be off


class ScanListener:
    """
    Calls on_scans(stamp_ns, ranges) with what the shepherds of a node see at one stamp.

    ranges maps a shepherd to an array (C, R) m, +inf for no return. It is called once all are
    complete, or when a later stamp comes in: then shepherds with a scan missing or not fit to use
    are left out. faults counts those, by what was wrong.
    """

    def __init__(
        self,
        node: ShepherdNode,
        lidar: LidarConfig,
        on_scans: Callable[[int, dict[int, np.ndarray]], None],
    ) -> None:
        """Make a listener that hears nobody; listen_to() subscribes."""
        self.node, self.lidar, self.on_scans = node, lidar, on_scans
        self.channels = lidar.layout.channels
        self.frame: str = node.option(
            'scan_frame', SHEPHERD, 'frame of the scans, behind any prefix; {h} is the shepherd'
        )
        self.faults: dict[str, int] = {}
        self._inputs: dict[int, list[Subscription]] = {}
        self._ns = -1
        self._parts: dict[int, dict[str, np.ndarray]] = {}

    def listen_to(self, shepherds: list[int]) -> None:
        """Subscribe to the scans of these shepherds, and to no others."""
        for h in self._inputs.keys() - set(shepherds):
            for subscription in self._inputs.pop(h):
                self.node.destroy_subscription(subscription)
        for h in [h for h in shepherds if h not in self._inputs]:
            self._inputs[h] = [
                self.node.listen(scan_topic(channel), self._receiver(h, channel), h)
                for channel in self.channels
            ]
        self.forget()

    def forget(self) -> None:
        """Start anew with whatever stamp comes next."""
        self._ns, self._parts = -1, {}

    def _receiver(self, shepherd: int, channel: str) -> Callable[[Scan], None]:
        def receive(scan: Scan) -> None:
            if scan.stamp_ns != self._ns:
                self._next(scan.stamp_ns)
            if self._fits(scan, shepherd, channel):
                self._parts.setdefault(shepherd, {})[channel] = scan.ranges
                if all(len(self._parts.get(h, ())) == len(self.channels) for h in self._inputs):
                    self._deliver()

        return receive

    def lacking(self) -> list[str]:
        """Return the scans that are missing of the present stamp, or of the next one."""
        return [
            scan_topic(channel).format(h=h)
            for h in self._inputs
            for channel in self.channels
            if channel not in self._parts.get(h, ())
        ]

    def unpublished(self) -> list[str]:
        """Return the scans that nobody publishes, of shepherds whose other scans have come."""
        return [
            name
            for h, parts in self._parts.items()
            for channel in self.channels
            for name in [scan_topic(channel).format(h=h)]
            if channel not in parts and not self.node.count_publishers(name)
        ]

    def _next(self, ns: int) -> None:
        """Turn to another stamp; what is there of the one before is delivered if it is older."""
        if self._parts and ns > self._ns:
            missing = [h for h in self._inputs if len(self._parts.get(h, ())) < len(self.channels)]
            for h in missing:
                lost = [name for name in self.channels if name not in self._parts.get(h, ())]
                self._fault('missing', h, lost[0], f'not all scans of {self._ns * 1e-9} s')
            self._deliver()
        self._ns, self._parts = ns, {}

    def _deliver(self) -> None:
        whole = {
            h: np.stack([parts[channel] for channel in self.channels])
            for h, parts in self._parts.items()
            if len(parts) == len(self.channels)
        }
        self._parts = {}
        self.on_scans(self._ns, whole)

    def _fits(self, scan: Scan, shepherd: int, channel: str) -> bool:
        """Return whether a scan is one that the lidar in mind could have made."""
        want, frame = self.lidar, self.frame.replace('{h}', str(shepherd))
        pitch = 2 * math.pi / want.n_rays
        kind = 'contract'
        if len(scan.ranges) != want.n_rays:
            wrong = f'{len(scan.ranges)} rays, expected {want.n_rays}'
        elif abs(scan.range_max - want.range_max) > 1e-3:
            wrong = f'range_max {scan.range_max} m, expected {want.range_max} m'
        elif abs(scan.angle_min) > 1e-6:
            wrong = f'angle_min {scan.angle_min} rad, expected 0'
        elif not abs(scan.angle_increment - pitch) < ANGLE_SLACK * pitch / want.n_rays:
            wrong = f'angle_increment {scan.angle_increment} rad, expected {pitch:.6f}'
        elif not abs(scan.angle_max - 2 * math.pi + pitch) < ANGLE_SLACK * pitch:
            wrong = f'angle_max {scan.angle_max} rad, expected {2 * math.pi - pitch:.6f}'
        elif not f'/{scan.frame_id}'.endswith(f'/{frame}'):
            wrong = f'frame {scan.frame_id!r:.60}, expected {frame!r}: see parameter scan_frame'
        elif not (scan.ranges >= 0).all():
            nan = bool(np.isnan(scan.ranges).any())
            kind, wrong = ('nan', 'ranges that are NaN') if nan else (kind, 'ranges below zero')
        else:
            return True
        self._fault(kind, shepherd, channel, wrong)
        return False

    def _fault(self, kind: str, shepherd: int, channel: str, words: str) -> None:
        self.faults[kind] = self.faults.get(kind, 0) + 1
        self.node.get_logger().warning(
            f'{scan_topic(channel).format(h=shepherd)}: {words}; the shepherd stands still for '
            'this stamp; start the lidar with the options that the checkpoint was trained with',
            throttle_duration_sec=SCAN_WARNING_PERIOD,
        )
