"""Tensors to messages and back, nothing else."""

from __future__ import annotations

from array import array
import struct
from typing import Any

from geometry_msgs.msg import PoseArray, PoseStamped, TwistStamped
import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import LaserScan
from shepherd_ros.nodes.base import nanoseconds, stamp
import torch
from torch import Tensor

_LITTLE_ENDIAN_CDR = b'\x00\x01\x00\x00'
LARGEST_FLOAT32 = float(np.finfo(np.float32).max)


def encode_poses(ns: int, frame_id: str, position: Tensor, heading: Tensor) -> bytes:
    """Return a geometry_msgs/PoseArray as CDR; position (K, 2) m, heading (K, 2) unit vectors."""
    frame = frame_id.encode() + b'\x00'
    head = struct.pack('<iII', ns // 1_000_000_000, ns % 1_000_000_000, len(frame)) + frame
    head += bytes(-len(head) % 4) + struct.pack('<I', len(position))
    head += bytes(-len(head) % 8)
    poses = np.zeros((len(position), 7), '<f8')
    poses[:, :2] = position.numpy()
    way = heading.numpy().astype(np.float64)
    half = np.arctan2(way[:, 1], way[:, 0]) / 2
    poses[:, 5], poses[:, 6] = np.sin(half), np.cos(half)
    return _LITTLE_ENDIAN_CDR + head + poses.tobytes()


def decode_poses(raw: bytes) -> tuple[int, str, Tensor, Tensor]:
    """Return stamp [ns], frame, positions (K, 2) m and headings (K, 2) of a PoseArray in CDR."""
    if raw[:4] != _LITTLE_ENDIAN_CDR:
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


def goal_message(ns: int, frame_id: str, goal: Tensor) -> PoseStamped:
    """Return the center of the goal region, (2,) m, as a pose."""
    message = PoseStamped()
    message.header.stamp, message.header.frame_id = stamp(ns), frame_id
    message.pose.position.x, message.pose.position.y = goal.tolist()
    return message


def scan_message(ns: int, frame_id: str, ranges: Tensor, range_max: float, dt: float) -> LaserScan:
    """Return ranges (R,) m of a full circle as a scan, +inf for no return (REP 117)."""
    pitch = 2 * np.pi / len(ranges)
    message = LaserScan(
        angle_min=0.0,
        angle_max=float((len(ranges) - 1) * pitch),
        angle_increment=float(pitch),
        scan_time=float(dt),
        range_min=0.0,
        range_max=float(range_max),
        ranges=array('f', ranges.numpy().tobytes()),
    )
    message.header.stamp, message.header.frame_id = stamp(ns), frame_id
    return message


def command_message(ns: int, frame_id: str, velocity: Tensor) -> TwistStamped:
    """Return a velocity (2,) m/s in the world frame that answers the state of a stamp."""
    message = TwistStamped()
    message.header.stamp, message.header.frame_id = stamp(ns), frame_id
    message.twist.linear.x, message.twist.linear.y = velocity.tolist()
    return message


def velocity_of(twist: Any) -> tuple[float, float]:
    """Return the velocity in the plane [m/s] of a geometry_msgs/Twist."""
    return twist.linear.x, twist.linear.y
