"""Messages to tensors, nothing else; the other way is bags.encode."""

from __future__ import annotations

import struct
from typing import Any

from geometry_msgs.msg import PoseArray, Twist, TwistStamped
import numpy as np
from rclpy.serialization import deserialize_message
from shepherd_ros.ros.node import nanoseconds
from shepherd_ros.wire.encode import ENCAPSULATION
import torch
from torch import Tensor

LARGEST_FLOAT32 = float(np.finfo(np.float32).max)


def decode_header(raw: bytes) -> tuple[int, str, int]:
    """Return stamp [ns], frame and end [bytes] of a header that little-endian CDR begins with."""
    sec, nanosec, length = struct.unpack_from('<iII', raw, 4)
    frame_id = raw[16 : 16 + length - 1].decode()
    return sec * 1_000_000_000 + nanosec, frame_id, 16 + length


def decode_stamp(raw: bytes, kind: Any) -> int:
    """Return the stamp [ns] of a message of a kind with a header."""
    if raw[:4] != ENCAPSULATION:
        return nanoseconds(deserialize_message(raw, kind).header.stamp)
    sec, nanosec = struct.unpack_from('<iI', raw, 4)
    return int(sec * 1_000_000_000 + nanosec)


def decode_poses(raw: bytes) -> tuple[int, str, Tensor, Tensor]:
    """Return stamp [ns], frame, positions (K, 2) m and headings (K, 2) of a PoseArray in CDR."""
    if raw[:4] != ENCAPSULATION:
        return _poses_of(deserialize_message(raw, PoseArray))
    ns, frame_id, at = decode_header(raw)
    at += -at % 4  # the encapsulation has four bytes, so this aligns the content too
    (count,) = struct.unpack_from('<I', raw, at)
    at += 4
    at += (4 - at) % 8
    poses = np.frombuffer(raw, '<f8', 7 * count, at if count else 0).reshape(count, 7)
    return ns, frame_id, *_plane(poses)


def _poses_of(message: PoseArray) -> tuple[int, str, Tensor, Tensor]:
    poses = np.array(
        [
            (p.position.x, p.position.y, 0.0, q.x, q.y, q.z, q.w)
            for p in message.poses
            for q in [p.orientation]
        ]
    ).reshape(-1, 7)
    return nanoseconds(message.header.stamp), message.header.frame_id, *_plane(poses)


def _plane(poses: np.ndarray) -> tuple[Tensor, Tensor]:
    """Return position and heading in the plane of poses (K, 7), in float32."""
    heading = np.empty((len(poses), 2), np.float32)
    x, y, z, w = np.ascontiguousarray(poses[:, 3:].T)
    heading[:, 0] = 1 - 2 * (y * y + z * z)
    heading[:, 1] = 2 * (w * z + x * y)
    return torch.from_numpy(poses[:, :2].astype(np.float32)), torch.from_numpy(heading)


def decode_command(raw: bytes) -> tuple[int, str, tuple[float, float]]:
    """Return stamp [ns], frame and velocity in the plane [m/s] of a TwistStamped in CDR."""
    if raw[:4] != ENCAPSULATION:
        message = deserialize_message(raw, TwistStamped)
        linear, header = message.twist.linear, message.header
        return nanoseconds(header.stamp), header.frame_id, (linear.x, linear.y)
    ns, frame_id, at = decode_header(raw)
    return ns, frame_id, struct.unpack_from('<2d', raw, at + (4 - at) % 8)


def decode_twist(raw: bytes) -> tuple[float, float]:
    """Return the velocity in the plane [m/s] of a Twist in CDR."""
    if raw[:4] != ENCAPSULATION:
        linear = deserialize_message(raw, Twist).linear
        return linear.x, linear.y
    return struct.unpack_from('<2d', raw, 4)
