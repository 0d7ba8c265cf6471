"""Scans that another lidar has made, or another shepherd, are refused by name."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from shepherd_ros.ros.scan_subscriber import ScanListener
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.wire.decode import decode_scan, Scan
from shepherd_ros.wire.encode import encode_scan

LIDAR = LidarConfig()
PITCH = 2 * math.pi / LIDAR.n_rays
RANGES = np.full(LIDAR.n_rays, 5.0, np.float32)
RANGES[::3] = np.inf


class Node:
    """What a listener needs of a node."""

    def __init__(self) -> None:
        """Begin with nothing said."""
        self.callbacks: dict[str, Any] = {}
        self.logged: list[str] = []

    def option(self, name: str, default: Any, doc: str) -> Any:
        """Return the default."""
        return default

    def listen(self, topic: str, callback: Any, shepherd: int) -> None:
        """Keep the callback."""
        self.callbacks[topic.format(h=shepherd)] = callback

    def get_logger(self) -> Node:
        """Return what hears warnings."""
        return self

    def warning(self, text: str, **kwargs: Any) -> None:
        """Keep a warning."""
        self.logged.append(text)


def good(shepherd: int = 0, prefix: str = '') -> Scan:
    """Return a scan as a lidar of the simulator makes it."""
    raw = encode_scan(1, f'{prefix}shepherd_{shepherd}', RANGES, LIDAR.range_max, 0.5)
    return decode_scan(raw)


@pytest.mark.parametrize('prefix', ['', 'a/', 'far/b/'])
def test_a_scan_of_the_simulator_fits_whatever_its_namespace(prefix: str) -> None:
    node, result = Node(), []
    listener = ScanListener(node, LIDAR, lambda ns, ranges: result.append(ranges))  # type: ignore
    listener.listen_to([7])
    for deliver in node.callbacks.values():
        deliver(good(7, prefix))
    assert node.logged == []
    assert result[0][7].shape == (3, LIDAR.n_rays)


@pytest.mark.parametrize(
    ('change', 'output'),
    [
        ({'angle_increment': PITCH / 2}, 'angle_increment 0.0061'),
        ({'angle_increment': -PITCH}, 'angle_increment -0.01227'),
        ({'angle_increment': math.nan}, 'angle_increment nan'),
        ({'angle_max': math.pi}, 'angle_max 3.14159'),
        ({'angle_max': math.inf}, 'angle_max inf'),
        ({'angle_min': -math.pi}, 'angle_min -3.14159'),
        ({'frame_id': 'shepherd_1'}, "frame 'shepherd_1', expected 'shepherd_0'"),
        ({'frame_id': 'xshepherd_0'}, "frame 'xshepherd_0'"),
        ({'frame_id': ''}, "frame ''"),
        ({'ranges': -RANGES}, 'ranges below zero'),
        ({'ranges': np.where(RANGES > 9, -np.inf, RANGES)}, 'ranges below zero'),
        ({'ranges': np.where(RANGES > 9, np.nan, RANGES)}, 'ranges that are NaN'),
    ],
    ids=str,
)
def test_a_scan_of_another_kind_is_refused_by_name(change: dict[str, Any], output: str) -> None:
    node, result = Node(), []
    listener = ScanListener(node, LIDAR, lambda ns, ranges: result.append(ranges))  # type: ignore
    listener.listen_to([0])
    for name, deliver in node.callbacks.items():
        deliver(good()._replace(**change) if name.endswith('goal') else good())
    assert result == []
    assert len(node.logged) == 1
    assert node.logged[0].startswith(f'shepherd_0/scan/goal: {output}')
    assert listener.missing_scans() == ['shepherd_0/scan/goal']
    assert sum(listener.faults.values()) == 1
