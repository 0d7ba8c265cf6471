"""Messages to tensors, nothing else; the other way is bags.encode."""

from __future__ import annotations

import struct
from typing import Any

from geometry_msgs.msg import PoseArray
import numpy as np
from rclpy.serialization import deserialize_message
from shepherd_ros.bags.encode import ENCAPSULATION
from shepherd_ros.nodes.base import nanoseconds
import torch
from torch import Tensor

LARGEST_FLOAT32 = float(np.finfo(np.float32).max)


def decode_poses(raw: bytes) -> tuple[int, str, Tensor, Tensor]:
    """Return stamp [ns], frame, positions (K, 2) m and headings (K, 2) of a PoseArray in CDR."""
    if raw[:4] != ENCAPSULATION:
        return _poses_of(deserialize_message(raw, PoseArray))
    sec, nanosec, length = struct.unpack_from('<iII', raw, 4)
    frame_id = raw[16 : 16 + length - 1].decode()
    at = 12 + length
    at += -at % 4
    (count,) = struct.unpack_from('<I', raw, 4 + at)
    at += 4
    at += -at % 8
    poses = np.frombuffer(raw, '<f8', 7 * count, 4 + at if count else 0).reshape(count, 7)
    return sec * 1_000_000_000 + nanosec, frame_id, *_plane(poses)


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
    x, y, z, w = poses[:, 3:].T
    heading = np.stack([1 - 2 * (y * y + z * z), 2 * (w * z + x * y)], axis=-1)
    position = poses[:, :2].astype(np.float32)
    return torch.from_numpy(position), torch.from_numpy(heading.astype(np.float32))


def velocity_of(twist: Any) -> tuple[float, float]:
    """Return the velocity in the plane [m/s] of a geometry_msgs/Twist."""
    return twist.linear.x, twist.linear.y
