"""CDR to numbers: equal to what rosbags decodes, and never more than the bytes say."""

from __future__ import annotations

from contextlib import suppress
from itertools import product
import math
import random
import struct

import numpy as np
import pytest
from rosbag2.tiny import cdr, header, make, pose, poses, recording, scan_of, STORE, twist
from shepherd_ros.wire.decode import (
    CdrError,
    decode_clock,
    decode_float64,
    decode_pose_stamped,
    decode_poses,
    decode_scan,
    decode_stamp,
    decode_string,
    decode_twist,
    decode_twist_stamped,
    DECODERS,
)
from shepherd_ros.wire.schemas import wire_types

NS = 12_345_678_901_234_567
FRAMES = ['', 'm', 'mp', 'map', 'maps', 'world', 'odometry', 'Weide für Schafe']


def test_poses() -> None:
    for frame_id, count in product(FRAMES, [0, 1, 2, 7, 100]):
        rng = np.random.default_rng(count)
        xy, bearing = rng.normal(size=(count, 2)), rng.uniform(-np.pi, np.pi, count)
        heading = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
        result = decode_poses(poses(NS, xy, heading, frame_id))
        assert (result.stamp_ns, result.frame_id) == (NS, frame_id)
        assert result.xy.dtype == np.float64
        assert np.array_equal(result.xy, xy)
        assert np.allclose(result.heading, heading, atol=1e-14)


def test_scans() -> None:
    for frame_id, count in product(FRAMES, [0, 1, 16, 512]):
        ranges = np.random.default_rng(count).uniform(0, 40, count).astype(np.float32)
        ranges[::3] = np.inf
        ranges[1::5] = np.nan
        result = decode_scan(scan_of(NS, ranges, frame_id))
        assert (result.stamp_ns, result.frame_id, result.range_max) == (NS, frame_id, 40.0)
        assert result.ranges.dtype == np.float32
        assert np.array_equal(result.ranges, ranges, equal_nan=True)
        assert math.isclose(result.angle_increment, 2 * math.pi / max(count, 1), rel_tol=1e-6)


def test_vectors() -> None:
    for frame_id in FRAMES:
        stamped = cdr(make('TwistStamped', header=header(NS, frame_id), twist=twist(0.25, -3.5)))
        result = decode_twist_stamped(stamped)
        assert (result.stamp_ns, result.frame_id, result.xy.tolist()) == (
            NS,
            frame_id,
            [0.25, -3.5],
        )
        plain = decode_twist(cdr(twist(0.25, -3.5)))
        assert (plain.stamp_ns, plain.xy.tolist()) == (None, [0.25, -3.5])
        goal = decode_pose_stamped(pose(NS, 1.5, 2.5))
        assert (goal.stamp_ns, goal.frame_id, goal.xy.tolist()) == (NS, 'world', [1.5, 2.5])


def test_small_ones() -> None:
    time = make('Time', sec=NS // 10**9, nanosec=NS % 10**9)
    assert decode_clock(cdr(make('Clock', clock=time))) == NS
    assert decode_float64(cdr(make('Float64', data=-0.1))) == -0.1
    for text in ('', 'x', 'Weide für Schafe', '{"a": 1}'):
        assert decode_string(cdr(make('String', data=text))) == text
    assert decode_stamp(poses(NS, np.zeros((3, 2)), np.zeros((3, 2)))) == NS


def test_what_ends_too_early_is_refused() -> None:
    text = cdr(make('String', data='map'))
    for raw, decode in (
        (text, decode_string),
        (cdr(make('Float64', data=1.0)), decode_float64),
        (poses(NS, np.ones((2, 2)), np.ones((2, 2)), 'map'), decode_poses),
    ):
        for size in range(len(raw) if decode is not decode_string else len(text) - 1):
            with pytest.raises(CdrError):
                decode(raw[:size])


def test_a_text_longer_than_its_message_is_told_in_numbers() -> None:
    raw = b'\0\1\0\0' + struct.pack('<I', 99) + b'odometry\0'
    with pytest.raises(CdrError, match=r'^17 bytes, a text of 99 bytes, where 9 are left$'):
        decode_string(raw)
    assert decode_string(raw[:4] + struct.pack('<I', 9) + raw[8:]) == 'odometry'


def test_stamps_before_the_epoch_do_not_wrap() -> None:
    message = cdr(make('PoseArray', header=header(-1), poses=[]))
    assert decode_poses(message).stamp_ns == -1


def test_every_message_of_the_recording_is_what_rosbags_says() -> None:
    for message in recording()[0]:
        reference = STORE.deserialize_cdr(message.data, message.type)
        own = DECODERS[message.type](message.data)
        if message.type.endswith('LaserScan'):
            assert np.array_equal(own.ranges, reference.ranges)
        elif message.type.endswith('PoseArray'):
            assert own.xy.tolist() == [[p.position.x, p.position.y] for p in reference.poses]
        elif message.type.endswith('TwistStamped'):
            assert own.xy.tolist() == [reference.twist.linear.x, reference.twist.linear.y]
        elif message.type.endswith('String'):
            assert own == reference.data


def test_big_endian_messages_are_read_too() -> None:
    little = make('TwistStamped', header=header(NS), twist=twist(0.25, -3.5))
    raw = bytes(STORE.serialize_cdr(little, little.__msgtype__, little_endian=False))
    assert raw[1] == 0
    assert decode_twist_stamped(raw).xy.tolist() == [0.25, -3.5]
    scan = STORE.deserialize_cdr(scan_of(NS, np.arange(5)), 'sensor_msgs/msg/LaserScan')
    raw = bytes(STORE.serialize_cdr(scan, scan.__msgtype__, little_endian=False))
    assert decode_scan(raw).ranges.tolist() == [0, 1, 2, 3, 4]


def test_what_the_contract_needs_can_be_decoded() -> None:
    assert set(wire_types()) - set(DECODERS) == {
        'diagnostic_msgs/msg/DiagnosticArray',
        'visualization_msgs/msg/MarkerArray',
    }


@pytest.mark.parametrize('kind', sorted(DECODERS))
def test_damaged_bytes_end_in_one_kind_of_error(kind: str) -> None:
    rng = random.Random(kind)
    samples = [m.data for m in recording()[0] if m.type == kind] or [cdr(twist(1.0, 2.0))]
    for _ in range(400):
        raw = bytearray(rng.choice(samples))
        del raw[rng.randrange(len(raw) + 1) :]
        for _ in range(rng.randrange(4)):
            if raw:
                raw[rng.randrange(min(len(raw), 40))] = rng.randrange(256)
        with suppress(CdrError):
            DECODERS[kind](bytes(raw))


def test_what_is_no_cdr_is_refused() -> None:
    for raw in [b'', b'\0', b'\0\1\0\0', b'\1\0\0\0' + bytes(99), b'\0\3' + bytes(99)]:
        with pytest.raises(CdrError):
            decode_poses(raw)
