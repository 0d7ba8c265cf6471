"""Encoding of the contract's messages as CDR, little endian, from plain arrays."""

from __future__ import annotations

from functools import lru_cache
import struct

import numpy as np

ENCAPSULATION = b'\x00\x01\x00\x00'  # plain CDR, little endian
_NS_PER_SECOND = 1_000_000_000  # [ns]


def _string(text: str) -> bytes:
    """Return a string with its length; offsets count from after the encapsulation."""
    content = text.encode() + b'\x00'
    return struct.pack('<I', len(content)) + content


def _header(ns: int, frame_id: str, align: int) -> bytes:
    """Return a std_msgs/Header, padded so that what follows is aligned to a size [bytes]."""
    return struct.pack('<iI', ns // _NS_PER_SECOND, ns % _NS_PER_SECOND) + _frame(frame_id, align)


@lru_cache(maxsize=256)
def _frame(frame_id: str, align: int) -> bytes:
    """Return the frame of a header, which begins at a multiple of 8 bytes, with its padding."""
    text = _string(frame_id)
    return text + bytes(-len(text) % align)


def encode_poses(ns: int, frame_id: str, position: np.ndarray, heading: np.ndarray) -> bytes:
    """Return a geometry_msgs/PoseArray; position (K, 2) m, heading (K, 2) unit vectors."""
    head = _header(ns, frame_id, 4) + struct.pack('<I', len(position))
    poses = np.zeros((len(position), 7), '<f8')
    poses[:, :2] = position
    unit_heading = heading.astype(np.float64)
    half = np.arctan2(unit_heading[:, 1], unit_heading[:, 0]) / 2
    poses[:, 5], poses[:, 6] = np.sin(half), np.cos(half)
    padding = bytes(-len(head) % 8 if poses.size else 0)
    return ENCAPSULATION + head + padding + poses.tobytes()


def encode_goal(ns: int, frame_id: str, x: float, y: float) -> bytes:
    """Return a geometry_msgs/PoseStamped at x, y [m] with the identity rotation."""
    pose = struct.pack('<7d', x, y, 0.0, 0.0, 0.0, 0.0, 1.0)
    return ENCAPSULATION + _header(ns, frame_id, 8) + pose


def encode_goal_poses(ns: int, frame_id: str, goal: np.ndarray, destination: np.ndarray) -> bytes:
    """Return goal and destination (2,) m as a geometry_msgs/PoseArray; yaw is the course."""
    position = np.stack([goal, destination]).astype(np.float64)
    return encode_poses(ns, frame_id, position, (position[1:] - position[:1]).repeat(2, axis=0))


def encode_scan(
    ns: int, frame_id: str, ranges: np.ndarray, range_max: float, scan_time: float
) -> bytes:
    """Return ranges (R,) m of a full circle from +x as sensor_msgs/LaserScan; +inf for none."""
    scan_fields = _scan_form(len(ranges), range_max, scan_time)
    values = np.ascontiguousarray(ranges, '<f4').tobytes()
    return b''.join((ENCAPSULATION, _header(ns, frame_id, 4), scan_fields, values, bytes(4)))


@lru_cache(maxsize=256)
def _scan_form(n_rays: int, range_max: float, scan_time: float) -> bytes:
    """Return the fields of a sensor_msgs/LaserScan between its header and its ranges."""
    pitch = 2 * np.pi / n_rays
    last = (n_rays - 1) * pitch
    return struct.pack('<7fI', 0.0, last, pitch, 0.0, scan_time, 0.0, range_max, n_rays)


def encode_twist(x: float, y: float) -> bytes:
    """Return a geometry_msgs/Twist with a velocity in the plane [m/s]."""
    return ENCAPSULATION + struct.pack('<6d', x, y, 0.0, 0.0, 0.0, 0.0)


def encode_command(ns: int, frame_id: str, x: float, y: float) -> bytes:
    """Return a geometry_msgs/TwistStamped with a velocity in the plane [m/s]."""
    return ENCAPSULATION + _header(ns, frame_id, 8) + encode_twist(x, y)[4:]


def encode_text(text: str) -> bytes:
    """Return a std_msgs/String."""
    return ENCAPSULATION + _string(text)


def encode_clock(ns: int) -> bytes:
    """Return a rosgraph_msgs/Clock."""
    return ENCAPSULATION + struct.pack('<iI', ns // _NS_PER_SECOND, ns % _NS_PER_SECOND)


def encode_bool(value: bool) -> bytes:
    """Return a std_msgs/Bool."""
    return ENCAPSULATION + struct.pack('?', value)


def encode_number(value: float) -> bytes:
    """Return a std_msgs/Float64."""
    return ENCAPSULATION + struct.pack('<d', value)
