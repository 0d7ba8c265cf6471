"""Subscriber of the lidars: scans of each shepherd, grouped by stamp."""

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
ANGLE_SLACK = 0.1  # error of the last angle, as a fraction of the angle between two rays


class ScanListener:
    """
    Calls on_scans(stamp_ns, ranges) with the scans of a node's shepherds at one stamp.

    ranges maps a shepherd to an array (C, R) m, +inf for no return. It is called once all are
    complete, or when a later stamp arrives: then shepherds with a missing or invalid scan are
    left out. faults counts those, by their kind.
    """

    def __init__(
        self,
        node: ShepherdNode,
        lidar: LidarConfig,
        on_scans: Callable[[int, dict[int, np.ndarray]], None],
    ) -> None:
        """Create a listener without subscriptions; listen_to() adds them."""
        self.node, self.lidar, self.on_scans = node, lidar, on_scans
        self.channels = lidar.layout.channels
        self.frame: str = node.option(
            'scan_frame', SHEPHERD, 'frame of the scans, behind any prefix; {h} is the shepherd'
        )
        self.faults: dict[str, int] = {}
        self._readers: dict[int, list[Subscription]] = {}
        self._stamp_ns = -1
        self._scans: dict[int, dict[str, np.ndarray]] = {}

    def listen_to(self, shepherds: list[int]) -> None:
        """Subscribe to the scans of these shepherds, and to no others."""
        for h in self._readers.keys() - set(shepherds):
            for subscription in self._readers.pop(h):
                self.node.destroy_subscription(subscription)
        for h in [h for h in shepherds if h not in self._readers]:
            self._readers[h] = [
                self.node.listen(scan_topic(channel), self._callback(h, channel), h)
                for channel in self.channels
            ]
        self.forget()

    def forget(self) -> None:
        """Drop the present scans; the next stamp may be any."""
        self._stamp_ns, self._scans = -1, {}

    def _callback(self, shepherd: int, channel: str) -> Callable[[Scan], None]:
        def receive(scan: Scan) -> None:
            if scan.stamp_ns != self._stamp_ns:
                self._next(scan.stamp_ns)
            if self._is_valid(scan, shepherd, channel):
                self._scans.setdefault(shepherd, {})[channel] = scan.ranges
                if all(len(self._scans.get(h, ())) == len(self.channels) for h in self._readers):
                    self._deliver()

        return receive

    def missing_scans(self) -> list[str]:
        """Return the topics whose scans are missing, of the present stamp or of the next one."""
        return [
            scan_topic(channel).format(h=h)
            for h in self._readers
            for channel in self.channels
            if channel not in self._scans.get(h, ())
        ]

    def unpublished(self) -> list[str]:
        """Return the topics without publisher, of shepherds whose other scans have arrived."""
        return [
            name
            for h, parts in self._scans.items()
            for channel in self.channels
            for name in [scan_topic(channel).format(h=h)]
            if channel not in parts and not self.node.count_publishers(name)
        ]

    def _next(self, ns: int) -> None:
        """Go on to another stamp; deliver the scans of the last one if it is older."""
        if self._scans and ns > self._stamp_ns:
            missing = [
                h for h in self._readers if len(self._scans.get(h, ())) < len(self.channels)
            ]
            for h in missing:
                absent = [name for name in self.channels if name not in self._scans.get(h, ())]
                self._fault('missing', h, absent[0], f'not all scans of {self._stamp_ns * 1e-9} s')
            self._deliver()
        self._stamp_ns, self._scans = ns, {}

    def _deliver(self) -> None:
        complete = {
            h: np.stack([parts[channel] for channel in self.channels])
            for h, parts in self._scans.items()
            if len(parts) == len(self.channels)
        }
        self._scans = {}
        self.on_scans(self._stamp_ns, complete)

    def _is_valid(self, scan: Scan, shepherd: int, channel: str) -> bool:
        """Return whether a scan agrees with the configuration of the lidar."""
        expected, frame = self.lidar, self.frame.replace('{h}', str(shepherd))
        pitch = 2 * math.pi / expected.n_rays
        kind = 'contract'
        if len(scan.ranges) != expected.n_rays:
            reason = f'{len(scan.ranges)} rays, expected {expected.n_rays}'
        elif abs(scan.range_max - expected.range_max) > 1e-3:
            reason = f'range_max {scan.range_max} m, expected {expected.range_max} m'
        elif abs(scan.angle_min) > 1e-6:
            reason = f'angle_min {scan.angle_min} rad, expected 0'
        elif not abs(scan.angle_increment - pitch) < ANGLE_SLACK * pitch / expected.n_rays:
            reason = f'angle_increment {scan.angle_increment} rad, expected {pitch:.6f}'
        elif not abs(scan.angle_max - 2 * math.pi + pitch) < ANGLE_SLACK * pitch:
            reason = f'angle_max {scan.angle_max} rad, expected {2 * math.pi - pitch:.6f}'
        elif not f'/{scan.frame_id}'.endswith(f'/{frame}'):
            reason = f'frame {scan.frame_id!r:.60}, expected {frame!r}: see parameter scan_frame'
        elif not (scan.ranges >= 0).all():
            nan = bool(np.isnan(scan.ranges).any())
            kind, reason = ('nan', 'ranges that are NaN') if nan else (kind, 'ranges below zero')
        else:
            return True
        self._fault(kind, shepherd, channel, reason)
        return False

    def _fault(self, kind: str, shepherd: int, channel: str, reason: str) -> None:
        self.faults[kind] = self.faults.get(kind, 0) + 1
        self.node.get_logger().warning(
            f'{scan_topic(channel).format(h=shepherd)}: {reason}; the shepherd stands still for '
            'this stamp; start the lidar with the options that the checkpoint was trained with',
            throttle_duration_sec=SCAN_WARNING_PERIOD,
        )
