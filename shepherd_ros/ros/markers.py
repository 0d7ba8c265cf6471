"""The world as markers, for RViz and Foxglove."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from geometry_msgs.msg import Point
from shepherd_ros.ros.node import stamp
from shepherd_ros.sim.lidar_layout import channel_of
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import from_bearing
from shepherd_ros.wire.topics import SHEPHERD
from std_msgs.msg import ColorRGBA
import torch
from torch import Tensor
from visualization_msgs.msg import Marker, MarkerArray

# Okabe and Ito's palette, which colour-blind people can tell apart
MARKER_COLORS = {
    'sheep': (0.35, 0.35, 0.35),
    'shepherds': (0.0, 0.45, 0.7),
    'goal': (0.9, 0.6, 0.0),
}


def _marker(ns: int, frame_id: str, name: str, kind: int, size: float, color: str) -> Marker:
    red, green, blue = MARKER_COLORS.get(color) or _rgb(channel_of(color).hit)
    marker = Marker(ns=name, id=0, type=kind, action=Marker.ADD)
    marker.header.stamp, marker.header.frame_id = stamp(ns), frame_id
    marker.pose.orientation.w = 1.0
    marker.scale.x = marker.scale.y = marker.scale.z = size
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
    return marker


def _rgb(color: str) -> tuple[float, ...]:
    """Return a colour such as #0072B2 as numbers from 0 to 1."""
    return tuple(value / 255 for value in bytes.fromhex(color.removeprefix('#')))


def _points(positions: Tensor) -> list[Any]:
    return [Point(x=x, y=y) for x, y in positions.tolist()]


def world_markers(ns: int, frame_id: str, state: WorldState) -> MarkerArray:
    """Return the goal as a flat disc, and sheep and shepherds as spheres."""
    goal = _marker(ns, frame_id, 'goal', Marker.CYLINDER, 2 * float(state.goal_radius), 'goal')
    goal.pose.position.x, goal.pose.position.y = state.goal.tolist()
    goal.scale.z, goal.color.a = 0.02, 0.4
    sheep = _marker(ns, frame_id, 'sheep', Marker.SPHERE_LIST, 0.5, 'sheep')
    sheep.points = _points(state.sheep)
    shepherds = _marker(ns, frame_id, 'shepherds', Marker.SPHERE_LIST, 1.0, 'shepherds')
    shepherds.points = _points(state.shepherds)
    return MarkerArray(markers=[goal, sheep, shepherds])


def ray_markers(
    ns: int, frame_id: str, shepherd: int, origin: Tensor, ranges: Mapping[str, Tensor]
) -> MarkerArray:
    """Return the rays of a lidar that hit something; origin (2,) m, ranges (R,) m by channel."""
    count = len(next(iter(ranges.values())))
    rays = from_bearing(torch.arange(count) * (2 * torch.pi / count))
    markers = []
    for channel, row in ranges.items():
        name = f'{SHEPHERD.format(h=shepherd)}/lidar/{channel}'
        marker = _marker(ns, frame_id, name, Marker.LINE_LIST, 0.03, channel)
        marker.color.a = 0.5
        hit = row.isfinite()
        ends = origin + rays[hit] * row[hit, None]
        marker.points = _points(torch.stack([origin.expand_as(ends), ends], dim=1).reshape(-1, 2))
        markers.append(marker)
    return MarkerArray(markers=markers)
