"""Messages, the description of an episode, the buffer of commands, parameters: no graph needed."""

from __future__ import annotations

import json
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
from shepherd_ros.config import ConfigError
from shepherd_ros.nodes.pending_commands import CommandBuffer
from shepherd_ros.ros.messages import (
    decode_command,
    decode_poses,
    decode_stamp,
    decode_twist,
)
from shepherd_ros.ros.node import nanoseconds, stamp
from shepherd_ros.ros.parameters import checked, descriptor
from shepherd_ros.sim.flocking import FLOCK_MODELS
from shepherd_ros.sim.lidar import TOUCHING
from shepherd_ros.sim.presets import PRESETS, training_world, world_preset
from shepherd_ros.sim.vectors import from_bearing
from shepherd_ros.wire import encode
from shepherd_ros.wire.encode import (
    encode_clock,
    encode_command,
    encode_goal,
    encode_number,
    encode_scan,
    encode_text,
    encode_twist,
)
from shepherd_ros.wire.episode import Episode
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


def encode_poses(ns: int, frame_id: str, position: torch.Tensor, heading: torch.Tensor) -> bytes:
    return encode.encode_poses(ns, frame_id, position.numpy(), heading.numpy())


# --- poses --------------------------------------------------------------------------------------


@pytest.mark.parametrize('frame_id', FRAMES)
@pytest.mark.parametrize('count', COUNTS)
def test_rclpy_reads_the_poses_that_we_write(count: int, frame_id: str) -> None:
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


@pytest.mark.parametrize('frame_id', FRAMES)
@pytest.mark.parametrize('count', COUNTS)
def test_we_read_the_poses_that_rclpy_writes(count: int, frame_id: str) -> None:
    position, heading = flock(count)
    raw = serialize_message(pose_array(position, heading, NS, frame_id))
    ns, frame, read, way = decode_poses(raw)
    assert (ns, frame) == (NS, frame_id)
    assert read.shape == way.shape == (count, 2)
    assert torch.equal(read, position)
    assert torch.allclose(way, heading, rtol=0, atol=1e-6)


@pytest.mark.parametrize('count', [0, 1, 3])
def test_our_bytes_are_those_of_rclpy_apart_from_padding(count: int) -> None:
    position, heading = flock(count)
    for frame_id in FRAMES:
        ours = encode_poses(NS, frame_id, position, heading)
        message = pose_array(position, heading, NS, frame_id)
        theirs = serialize_message(message)
        assert len(ours) - len(theirs) in ({0, 4} if count == 0 else {0}), frame_id
        assert ours[: 16 + len(frame_id.encode())] == theirs[: 16 + len(frame_id.encode())]
        assert ours[len(ours) - 56 * count :] == theirs[len(theirs) - 56 * count :]


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
    read_ns, read_frame, read, way = decode_poses(encode_poses(ns, frame_id, position, heading))
    assert (read_ns, read_frame) == (ns, frame_id)
    assert torch.equal(read, position)
    assert torch.allclose(way, heading, rtol=0, atol=1e-6)


def test_a_shepherd_that_stands_has_yaw_zero() -> None:
    raw = encode_poses(0, 'map', torch.zeros(1, 2), torch.zeros(1, 2))
    orientation = deserialize_message(raw, PoseArray).poses[0].orientation
    assert (orientation.z, orientation.w) == (0.0, 1.0)


def test_nan_and_infinite_positions_are_carried_for_the_reader_to_refuse() -> None:
    position = torch.tensor([[math.nan, math.inf], [-math.inf, 1.0]])
    _, _, read, _ = decode_poses(encode_poses(0, 'map', position, torch.ones(2, 2)))
    assert torch.equal(read, position) or torch.allclose(read, position, equal_nan=True)


# --- scans, goal, commands ----------------------------------------------------------------------


@pytest.mark.parametrize('n_rays', [4, 7, 512])
def test_a_scan_follows_rep_117_and_its_angles_are_those_of_the_rays(n_rays: int) -> None:
    ranges = torch.linspace(TOUCHING, 75.0, n_rays)
    ranges[1], ranges[2] = math.inf, 10.0
    message = read_back(encode_scan(NS, 'shepherd_0', ranges.numpy(), 75.0, 0.5), LaserScan)
    read = np.frombuffer(message.ranges, np.float32)
    assert np.array_equal(read, ranges.numpy())  # exactly, +inf kept: no return
    assert nanoseconds(message.header.stamp) == NS
    assert message.header.frame_id == 'shepherd_0'
    assert message.range_min <= TOUCHING
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
    assert message.pose.orientation.w == 1.0


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


# --- episode ------------------------------------------------------------------------------------


def episode_of(preset: str = 'default', model: str = 'strombom', **changes: Any) -> Episode:
    """Return an episode with a world of a preset."""
    world = world_preset(preset, model)
    values: dict[str, Any] = {
        'number': 2, 'seed': 41, 'start_ns': 7_500_000_000, 'n_sheep': 100, 'n_shepherds': 3,
        'goal_radius': 4.123456789, 'frame_id': 'map', 'mode': 'lockstep', 'world': world,
    }  # fmt: skip
    return Episode(**(values | changes))


@pytest.mark.parametrize('model', sorted(FLOCK_MODELS))
@pytest.mark.parametrize('preset', sorted(PRESETS))
def test_an_episode_comes_back_from_json_as_it_was(preset: str, model: str) -> None:
    episode = episode_of(preset, model)
    assert Episode.from_json(episode.to_json()) == episode
    other = episode_of(world=training_world(episode.world), seed=-3, start_ns=0)
    assert Episode.from_json(other.to_json()) == other


def test_steps_of_an_episode_are_counted_from_its_first_stamp() -> None:
    episode = episode_of()  # 1000 steps of 0.5 s from 7.5 s on
    assert episode.dt_ns == 500_000_000
    assert episode.step_of(7_500_000_000) == 0
    assert episode.step_of(8_000_000_000) == 1
    assert episode.has(7_500_000_000)
    assert episode.has(507_500_000_000)
    assert not episode.has(7_000_000_000)
    assert not episode.has(508_000_000_000)


def changed(**changes: Any) -> str:
    """Return an episode as JSON with other values at its top."""
    return json.dumps(json.loads(episode_of().to_json()) | changes)


@pytest.mark.parametrize(
    ('text', 'pattern'),
    [
        ('', 'cannot be read'),
        ('no JSON', "'no JSON' cannot be read"),
        ('null', 'cannot be read'),
        ('[]', 'cannot be read'),
        ('3', 'cannot be read'),
        ('{}', "KeyError.*'schema'"),
        ('{"schema": 1}', "KeyError.*'number'"),
        (changed(schema=99), 'schema is 99: expected 1'),
        (changed(start=None), 'cannot be read'),
        (changed(start={'sec': '1', 'nanosec': 0}), 'cannot be read'),
        (changed(seed='seven'), 'seven'),
        (changed(n_sheep=math.inf), 'cannot be read'),
        (changed(goal_radius='wide'), 'wide'),
        (changed(world=[]), 'cannot be read|expected a mapping'),
        (changed(world={'flock': 'strombom'}), 'cannot be read|expected a mapping'),
        (changed(world={'flock': {'model': 'boids'}}), "flock is 'boids': expected one of"),
        (changed(world={'dt': 'half'}), "dt is 'half'.*expected float"),
        (changed(world={'dt': math.nan}), 'dt is nan: expected a finite number'),
        (changed(world={'weather': 'fine'}), 'weather'),
        (changed(world={'spawn': {'place': 1}}), "'place'"),
    ],
    ids=lambda value: value[:12],
)
def test_a_bad_episode_is_refused_in_words(text: str, pattern: str) -> None:
    with pytest.raises(ConfigError, match=pattern):
        Episode.from_json(text)


# --- commands -----------------------------------------------------------------------------------


def test_a_new_buffer_waits_for_everybody() -> None:
    buffer = CommandBuffer(3)
    assert not buffer.complete
    assert buffer.silent() == [0, 1, 2]
    assert buffer.velocity.tolist() == [[0.0, 0.0]] * 3


def test_the_buffer_is_complete_once_everybody_has_answered() -> None:
    buffer = CommandBuffer(2)
    buffer.add(1, (0.5, -0.5))
    assert not buffer.complete
    assert buffer.silent() == [0]
    buffer.add(0, (1.0, 0.0))
    assert buffer.complete
    assert buffer.velocity.tolist() == [[1.0, 0.0], [0.5, -0.5]]


def test_a_later_answer_replaces_an_earlier_one() -> None:
    buffer = CommandBuffer(1)
    buffer.add(0, (1.0, 0.0))
    buffer.add(0, (0.0, 2.0))
    assert buffer.velocity.tolist() == [[0.0, 2.0]]


def test_a_new_state_asks_everybody_again() -> None:
    buffer = CommandBuffer(2)
    buffer.add(0, (1.0, 0.0))
    buffer.add(1, (1.0, 0.0))
    buffer.expect()
    assert buffer.silent() == [0, 1]


def test_a_command_is_held_until_it_is_older_than_the_watchdog_allows() -> None:
    buffer = CommandBuffer(2)
    buffer.add(0, (1.0, 2.0))
    ages = []
    for _ in range(5):
        ages.append((buffer.age[0], buffer.held(3).tolist()))
        buffer.expect()
    kept, stopped = [[1.0, 2.0], [0.0, 0.0]], [[0.0, 0.0]] * 2
    assert ages == [(0, kept), (1, kept), (2, kept), (3, kept), (4, stopped)]
    buffer.add(0, (3.0, 0.0))  # it wakes up
    assert buffer.held(3).tolist() == [[3.0, 0.0], [0.0, 0.0]]


def test_a_watchdog_of_zero_steps_takes_only_answers_to_the_present_state() -> None:
    buffer = CommandBuffer(1)
    buffer.add(0, (1.0, 0.0))
    assert buffer.held(0).tolist() == [[1.0, 0.0]]
    buffer.expect()
    assert buffer.held(0).tolist() == [[0.0, 0.0]]


def test_a_shepherd_that_never_spoke_never_moves_whatever_the_watchdog() -> None:
    buffer = CommandBuffer(1)
    for _ in range(3):
        buffer.expect()
    assert buffer.held(2**29).tolist() == [[0.0, 0.0]]


def test_a_nan_in_a_command_is_kept_for_the_world_to_refuse() -> None:
    buffer = CommandBuffer(1)
    buffer.add(0, (math.nan, math.inf))
    assert buffer.complete
    assert not buffer.velocity.isfinite().any()


# --- parameters ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ('value', 'default', 'limits', 'expected'),
    [
        (20, 0.5, {}, 20.0),  # an integer is taken where a float is expected
        (0.25, 0.5, {}, 0.25),
        (7, 3, {}, 7),
        (True, False, {}, True),
        ('b', 'a', {'choices': ('a', 'b')}, 'b'),
        ([1, 2], [0], {}, [1, 2]),
        (1, 0.5, {'low': 1, 'high': 1}, 1.0),
    ],
)
def test_a_good_parameter_is_taken_in_the_type_of_its_default(
    value: Any, default: Any, limits: dict[str, Any], expected: Any
) -> None:
    result = checked('x', value, default, limits)
    assert result == expected
    assert type(result) is type(default)


@pytest.mark.parametrize(
    ('value', 'default', 'limits', 'pattern'),
    [
        (True, 0.5, {}, r'x is True \(bool\): expected float, such as 0.5'),
        (True, 3, {}, r'x is True \(bool\): expected int, such as 3'),
        (1, False, {}, r'x is 1 \(int\): expected bool, such as False'),
        (2.0, 3, {}, r'x is 2.0 \(float\): expected int, such as 3'),
        ('2', 0.5, {}, r"x is '2' \(str\): expected float, such as 0.5"),
        (5, 'a', {}, r'x is 5 \(int\): expected str'),
        (5, [0], {}, r'x is 5 \(int\): expected list, such as \[0\]'),
        (math.nan, 0.5, {}, 'x is nan: expected a finite number, such as 0.5'),
        (-math.inf, 0.5, {}, 'x is -inf: expected a finite number'),
        (0, 3, {'low': 1}, r'x is 0: expected a value in \[1, inf\], such as 3'),
        (2, 0.5, {'high': 1.0}, r'x is 2.0: expected a value in \[-inf, 1.0\]'),
        ('c', 'a', {'choices': ('a', 'b')}, "x is 'c': expected one of a, b"),
        ('alphb', 'alpha', {'choices': ('alpha', 'z')}, "did you mean 'alpha'"),
    ],
)
def test_a_bad_parameter_is_refused_with_value_expectation_and_example(
    value: Any, default: Any, limits: dict[str, Any], pattern: str
) -> None:
    with pytest.raises(ConfigError, match=pattern):
        checked('x', value, default, limits)


def test_a_descriptor_has_the_range_on_both_sides_even_if_only_one_is_given() -> None:
    described = descriptor(0.5, {'doc': 'a share', 'low': 0.0}, read_only=True)
    (interval,) = described.floating_point_range
    assert (interval.from_value, interval.step) == (0.0, 0.0)
    assert interval.to_value >= 1e9
    assert described.description == 'a share'
    assert described.read_only
    described = descriptor(3, {'doc': 'a count', 'low': 1, 'high': 9}, read_only=False)
    (interval,) = described.integer_range
    assert (interval.from_value, interval.to_value, interval.step) == (1, 9, 0)
    assert not described.read_only
    described = descriptor('a', {'doc': 'a name', 'choices': ('a', 'b')}, read_only=True)
    assert 'a, b' in described.additional_constraints
    assert not described.integer_range
    assert not described.floating_point_range


@pytest.mark.parametrize('frame_id', FRAMES)
def test_goal_and_command_are_read_whatever_the_length_of_the_frame(frame_id: str) -> None:
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


@pytest.mark.parametrize('frame_id', ['', 'map', 'shepherd_0'])
def test_commands_and_stamps_are_read_from_both_kinds_of_machine(frame_id: str) -> None:
    message = TwistStamped()
    message.header.stamp, message.header.frame_id = stamp(3_500_000_000), frame_id
    message.twist.linear.x, message.twist.linear.y = 0.25, -0.5
    expected = 3_500_000_000, frame_id, (0.25, -0.5)
    assert decode_command(serialize_message(message)) == expected
    assert decode_command(encode_command(3_500_000_000, frame_id, 0.25, -0.5)) == expected
    velocity = struct.pack('>6d', 0.25, -0.5, 0.0, 0.0, 0.0, 0.0)
    assert decode_command(big_endian(frame_id, 8) + velocity) == expected
    assert decode_stamp(big_endian(frame_id, 8) + velocity, TwistStamped) == 3_500_000_000
    assert decode_stamp(serialize_message(message), TwistStamped) == 3_500_000_000


def test_a_plain_velocity_is_read_from_both_kinds_of_machine() -> None:
    assert decode_twist(encode_twist(0.25, -0.5)) == (0.25, -0.5)
    assert decode_twist(serialize_message(Twist())) == (0.0, 0.0)
    velocity = struct.pack('>6d', 0.25, -0.5, 0.0, 0.0, 0.0, 0.0)
    assert decode_twist(b'\x00\x00\x00\x00' + velocity) == (0.25, -0.5)
