"""Encoded messages are those of rclpy, and decoded ones are read as rclpy reads them."""

from __future__ import annotations

from itertools import product
import math
import struct
from typing import Any

from geometry_msgs.msg import Pose, PoseArray, PoseStamped, Twist, TwistStamped
from hypothesis import given as for_all
from hypothesis import settings
from hypothesis import strategies as st
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from shepherd_ros.ros.node import nanoseconds, stamp
from shepherd_ros.sim.lidar import CONTACT_RANGE
from shepherd_ros.sim.vectors import from_bearing
from shepherd_ros.wire import decode, encode
from shepherd_ros.wire.decode import decode_stamp, decode_twist, decode_twist_stamped
from shepherd_ros.wire.encode import (
    encode_clock,
    encode_command,
    encode_goal,
    encode_number,
    encode_scan,
    encode_text,
    encode_twist,
)
from std_msgs.msg import Float64, String
import torch
from torch import Tensor

COUNTS = [0, 1, 3, 1000]
FRAMES = ['', 'm', 'mp', 'map', 'maps', 'world', 'odometry', 'field_1/map', 'Weide für Schafe']
NS = 12_345_678_901_234_567


def flock(count: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Return positions (count, 2) m and headings (count, 2)."""
    rng = torch.Generator().manual_seed(seed)
    position = 40 * torch.randn(count, 2, generator=rng)
    return position, from_bearing(2 * math.pi * torch.rand(count, generator=rng))


def pose_array(position: Tensor, heading: Tensor, ns: int, frame_id: str) -> PoseArray:
    """Return the message that rclpy alone would build."""
    message = PoseArray()
    message.header.stamp, message.header.frame_id = stamp(ns), frame_id
    for (x, y), (c, s) in zip(position.tolist(), heading.tolist(), strict=True):
        pose = Pose()
        pose.position.x, pose.position.y = x, y
        yaw = math.atan2(s, c)
        pose.orientation.z, pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        message.poses.append(pose)
    return message


def read_back(raw: bytes, kind: type) -> Any:
    """Return the message that rclpy reads, which it writes in as many bytes."""
    message = deserialize_message(raw, kind)
    assert len(serialize_message(message)) == len(raw)
    return message


def encode_poses(ns: int, frame_id: str, position: Tensor, heading: Tensor) -> bytes:
    return encode.encode_poses(ns, frame_id, position.numpy(), heading.numpy())


def decode_poses(raw: bytes) -> tuple[int, str, Tensor, Tensor]:
    """Return stamp [ns], frame, positions (K, 2) m and headings (K, 2), as nodes read them."""
    ns, frame_id, xy, heading = decode.decode_poses(raw)
    return ns, frame_id, torch.tensor(xy, dtype=torch.float32), torch.tensor(heading).float()


def decode_command(raw: bytes) -> tuple[int | None, str, tuple[float, ...]]:
    """Return stamp [ns], frame and velocity of a TwistStamped."""
    ns, frame_id, *velocity = decode_twist_stamped(raw)
    return ns, frame_id, tuple(velocity)


def test_rclpy_reads_the_poses_that_we_write() -> None:
    for frame_id, count in product(FRAMES, COUNTS):
        position, heading = flock(count)
        message = deserialize_message(encode_poses(NS, frame_id, position, heading), PoseArray)
        assert nanoseconds(message.header.stamp) == NS
        assert message.header.frame_id == frame_id
        read = [(p.position.x, p.position.y, p.position.z) for p in message.poses]
        assert read == [(x, y, 0.0) for x, y in position.tolist()]
        for pose, (c, s) in zip(message.poses, heading.tolist(), strict=True):
            q = pose.orientation
            assert (q.x, q.y) == (0.0, 0.0)
            assert math.isclose(q.z * q.z + q.w * q.w, 1.0, abs_tol=1e-12)
            assert abs(2 * math.atan2(q.z, q.w) - math.atan2(s, c)) % (2 * math.pi) < 1e-6


def test_we_read_the_poses_that_rclpy_writes() -> None:
    for frame_id, count in product(FRAMES, COUNTS):
        position, heading = flock(count)
        raw = serialize_message(pose_array(position, heading, NS, frame_id))
        ns, frame, read, direction = decode_poses(raw)
        assert (ns, frame) == (NS, frame_id)
        assert read.shape == direction.shape == (count, 2)
        assert torch.equal(read, position)
        assert torch.allclose(direction, heading, rtol=0, atol=1e-6)


def test_our_bytes_are_those_of_rclpy_apart_from_padding() -> None:
    for count in [0, 1, 3]:
        position, heading = flock(count)
        for frame_id in FRAMES:
            own = encode_poses(NS, frame_id, position, heading)
            message = pose_array(position, heading, NS, frame_id)
            reference = serialize_message(message)
            assert len(own) - len(reference) in ({0, 4} if count == 0 else {0}), frame_id
            assert own[: 16 + len(frame_id.encode())] == reference[: 16 + len(frame_id.encode())]
            assert own[len(own) - 56 * count :] == reference[len(reference) - 56 * count :]


def test_poses_of_a_big_endian_machine_are_read_too() -> None:
    # encapsulation, stamp, frame 'map', one pose at (1.5, -2) with yaw 90 degrees
    half = math.sqrt(0.5)
    raw = b'\x00\x00\x00\x00' + struct.pack('>iII4sI', 3, 500_000_000, 4, b'map\x00', 1)
    raw += bytes(4) + struct.pack('>7d', 1.5, -2.0, 0.0, 0.0, 0.0, half, half)
    ns, frame, position, heading = decode_poses(raw)
    assert (ns, frame) == (3_500_000_000, 'map')
    assert position.tolist() == [[1.5, -2.0]]
    assert torch.allclose(heading, torch.tensor([[0.0, 1.0]]), atol=1e-7)


@for_all(
    st.lists(st.tuples(*[st.floats(width=32, allow_nan=False)] * 2), max_size=20),
    st.integers(0, 2**31 * 10**9 - 1),
    st.text(st.characters(blacklist_characters='\x00', blacklist_categories=['Cs']), max_size=9),
    st.floats(-math.pi, math.pi),
)
@settings(max_examples=200, deadline=None)
def test_positions_come_back_exactly_and_headings_to_a_millionth(
    points: list[tuple[float, float]], ns: int, frame_id: str, angle: float
) -> None:
    position = torch.tensor(points, dtype=torch.float32).reshape(-1, 2)
    heading = from_bearing(torch.full((len(points),), angle))
    read_ns, read_frame, read, direction = decode_poses(
        encode_poses(ns, frame_id, position, heading)
    )
    assert (read_ns, read_frame) == (ns, frame_id)
    assert torch.equal(read, position)
    assert torch.allclose(direction, heading, rtol=0, atol=1e-6)


def test_a_shepherd_that_stands_has_yaw_zero() -> None:
    raw = encode_poses(0, 'map', torch.zeros(1, 2), torch.zeros(1, 2))
    orientation = deserialize_message(raw, PoseArray).poses[0].orientation
    assert (orientation.z, orientation.w) == (0.0, 1.0)


def test_nan_and_infinite_positions_are_carried_for_the_reader_to_refuse() -> None:
    position = torch.tensor([[math.nan, math.inf], [-math.inf, 1.0]])
    _, _, read, _ = decode_poses(encode_poses(0, 'map', position, torch.ones(2, 2)))
    assert torch.equal(read, position) or torch.allclose(read, position, equal_nan=True)


@pytest.mark.parametrize('n_rays', [4, 7, 512])
def test_a_scan_follows_rep_117_and_its_angles_are_those_of_the_rays(n_rays: int) -> None:
    ranges = torch.linspace(CONTACT_RANGE, 75.0, n_rays)
    ranges[1], ranges[2] = math.inf, 10.0
    message = read_back(encode_scan(NS, 'shepherd_0', ranges.numpy(), 75.0, 0.5), LaserScan)
    read = np.frombuffer(message.ranges, np.float32)
    assert np.array_equal(read, ranges.numpy())  # exactly, +inf kept: no return
    assert nanoseconds(message.header.stamp) == NS
    assert message.header.frame_id == 'shepherd_0'
    assert message.range_min <= CONTACT_RANGE
    assert message.range_max == 75.0
    assert math.isclose(message.scan_time, 0.5)
    assert message.time_increment == 0.0  # all rays at once
    assert len(message.intensities) == 0
    # what a consumer computes from the header
    assert message.angle_min == 0.0
    assert round((message.angle_max - message.angle_min) / message.angle_increment) + 1 == n_rays
    for k in (0, 1, n_rays - 1):
        angle = message.angle_min + k * message.angle_increment
        assert math.isclose(angle, 2 * math.pi * k / n_rays, abs_tol=1e-5)


def test_the_goal_is_a_pose_with_its_stamp_and_frame() -> None:
    message = read_back(encode_goal(NS, 'field', 1.5, -2.25), PoseStamped)
    point = message.pose.position
    assert (point.x, point.y, point.z) == (1.5, -2.25, 0.0)
    assert message.header.frame_id == 'field'
    assert nanoseconds(message.header.stamp) == NS
    turn = message.pose.orientation
    assert (turn.x, turn.y, turn.z, turn.w) == (0.0, 0.0, 0.0, 1.0)


def test_a_command_is_a_stamped_velocity_in_the_plane() -> None:
    message = read_back(encode_command(NS, 'map', 0.25, -0.5), TwistStamped)
    assert nanoseconds(message.header.stamp) == NS
    assert message.header.frame_id == 'map'
    assert (message.twist.linear.x, message.twist.linear.y) == (0.25, -0.5)
    others = (message.twist.linear.z, message.twist.angular.x, message.twist.angular.z)
    assert others == (0.0, 0.0, 0.0)


@for_all(st.integers(0, 2**31 * 10**9 - 1))
def test_nanoseconds_survive_the_way_through_a_stamp(ns: int) -> None:
    assert nanoseconds(stamp(ns)) == ns


def test_goal_and_command_are_read_whatever_the_length_of_the_frame() -> None:
    for frame_id in FRAMES:
        command = read_back(encode_command(NS, frame_id, 0.25, -0.5), TwistStamped)
        goal = read_back(encode_goal(NS, frame_id, 3.0, 4.0), PoseStamped)
        assert (command.header.frame_id, command.twist.linear.y) == (frame_id, -0.5)
        assert (goal.header.frame_id, goal.pose.position.y) == (frame_id, 4.0)


def test_what_has_no_header_comes_back() -> None:
    twist = read_back(encode_twist(0.25, -0.5), Twist)
    assert (twist.linear.x, twist.linear.y) == (0.25, -0.5)
    assert read_back(encode_text('Schäfer {}'), String).data == 'Schäfer {}'
    assert nanoseconds(read_back(encode_clock(NS), Clock).clock) == NS
    assert read_back(encode_number(math.pi), Float64).data == math.pi


def big_endian(frame_id: str, align: int) -> bytes:
    """Return a header of stamp 3.5 s as a big-endian machine writes it."""
    head = struct.pack('>iII', 3, 500_000_000, len(frame_id) + 1) + frame_id.encode() + bytes(1)
    return b'\x00\x00\x00\x00' + head + bytes(-len(head) % align)


def test_commands_and_stamps_are_read_from_both_kinds_of_machine() -> None:
    for frame_id in ['', 'map', 'shepherd_0']:
        message = TwistStamped()
        message.header.stamp, message.header.frame_id = stamp(3_500_000_000), frame_id
        message.twist.linear.x, message.twist.linear.y = 0.25, -0.5
        expected = 3_500_000_000, frame_id, (0.25, -0.5)
        assert decode_command(serialize_message(message)) == expected
        assert decode_command(encode_command(3_500_000_000, frame_id, 0.25, -0.5)) == expected
        velocity = struct.pack('>6d', 0.25, -0.5, 0.0, 0.0, 0.0, 0.0)
        assert decode_command(big_endian(frame_id, 8) + velocity) == expected
        assert decode_stamp(big_endian(frame_id, 8) + velocity) == 3_500_000_000
        assert decode_stamp(serialize_message(message)) == 3_500_000_000


def test_a_plain_velocity_is_read_from_both_kinds_of_machine() -> None:
    assert decode_twist(encode_twist(0.25, -0.5)).xy.tolist() == [0.25, -0.5]
    assert decode_twist(serialize_message(Twist())).xy.tolist() == [0.0, 0.0]
    velocity = struct.pack('>6d', 0.25, -0.5, 0.0, 0.0, 0.0, 0.0)
    assert decode_twist(b'\x00\x00\x00\x00' + velocity).xy.tolist() == [0.25, -0.5]
