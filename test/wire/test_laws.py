"""Encoding and decoding undo each other, in the words of rosbags and of rclpy alike."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

from hypothesis import given as for_all
from hypothesis import settings
from hypothesis import strategies as st
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosbag2.tiny import STORE
from shepherd_ros.ros.node import message_type
from shepherd_ros.wire.decode import DECODERS, Poses, Scan, Vector
from shepherd_ros.wire.encode import (
    encode_bool,
    encode_clock,
    encode_command,
    encode_goal,
    encode_number,
    encode_poses,
    encode_scan,
    encode_text,
    encode_twist,
)

NS = st.integers(0, 2**31 * 10**9 - 1)
TEXT = st.text(st.characters(blacklist_characters='\0', blacklist_categories=['Cs']), max_size=20)
NUMBER = st.floats()  # NaN and infinities too
RANGES = st.lists(st.floats(0, width=32), min_size=1, max_size=40)
BEARINGS = st.lists(st.tuples(NUMBER, NUMBER, st.floats(-math.pi, math.pi)), max_size=20)


def poses(ns: int, frame_id: str, rows: list[tuple[float, float, float]]) -> tuple[bytes, Poses]:
    """Return poses as CDR, and what they say."""
    table = np.array(rows).reshape(-1, 3)
    heading = np.stack([np.cos(table[:, 2]), np.sin(table[:, 2])], axis=-1)
    return encode_poses(ns, frame_id, table[:, :2], heading), Poses(
        ns, frame_id, table[:, :2], heading
    )


def scan(ns: int, frame_id: str, ranges: list[float], most: float) -> tuple[bytes, Scan]:
    """Return a scan as CDR, and what it says."""
    array, pitch = np.array(ranges, np.float32), 2 * np.pi / len(ranges)
    last, pitch = float(np.float32((len(ranges) - 1) * pitch)), float(np.float32(pitch))
    content = Scan(ns, frame_id, 0.0, last, pitch, 0.0, most, array)
    return encode_scan(ns, frame_id, array, most, 0.5), content


def vector(ns: int | None, frame_id: str, x: float, y: float) -> Vector:
    """Return a vector in the plane."""
    return Vector(ns, frame_id, x, y)


XY = (NUMBER, NUMBER)
MADE: dict[str, st.SearchStrategy[tuple[bytes, Any]]] = {
    'geometry_msgs/msg/PoseArray': st.builds(poses, NS, TEXT, BEARINGS),
    'geometry_msgs/msg/PoseStamped': st.builds(
        lambda *a: (encode_goal(*a), vector(*a)), NS, TEXT, *XY
    ),
    'geometry_msgs/msg/Twist': st.builds(lambda *a: (encode_twist(*a), vector(None, '', *a)), *XY),
    'geometry_msgs/msg/TwistStamped': st.builds(
        lambda *a: (encode_command(*a), vector(*a)), NS, TEXT, *XY
    ),
    'rosgraph_msgs/msg/Clock': st.builds(lambda ns: (encode_clock(ns), ns), NS),
    'sensor_msgs/msg/LaserScan': st.builds(
        scan, NS, TEXT, RANGES, st.floats(0, 2.0**100, width=32)
    ),
    'std_msgs/msg/Bool': st.builds(lambda on: (encode_bool(on), on), st.booleans()),
    'std_msgs/msg/Float64': st.builds(lambda x: (encode_number(x), x), NUMBER),
    'std_msgs/msg/String': st.builds(lambda text: (encode_text(text), text), TEXT),
}


def same(one: Any, other: Any) -> bool:
    """Return whether two contents are equal, NaN to NaN, headings to rounding."""
    if isinstance(one, Poses):
        near = np.allclose(one.heading, other.heading, rtol=0, atol=1e-14)
        return near and same(tuple(one[:3]), tuple(other[:3]))
    if isinstance(one, tuple):
        return all(same(a, b) for a, b in zip(one, other, strict=True))
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other, equal_nan=True)
    return bool(one == other or (one != one and other != other))


def by_rosbags(raw: bytes, kind: str) -> bytes:
    """Return a message that rosbags reads and writes again."""
    return bytes(STORE.serialize_cdr(STORE.deserialize_cdr(raw, kind), kind))


def by_rclpy(raw: bytes, kind: str) -> bytes:
    """Return a message that rclpy reads and writes again."""
    return bytes(serialize_message(deserialize_message(raw, message_type(kind))))


def test_all_types_that_can_be_decoded_can_be_encoded() -> None:
    assert set(MADE) == set(DECODERS)


@pytest.mark.parametrize('again', [by_rosbags, by_rclpy])
@pytest.mark.parametrize('kind', sorted(DECODERS))
def test_what_was_encoded_is_decoded_whoever_carries_it(
    kind: str, again: Callable[[bytes, str], bytes]
) -> None:
    @for_all(MADE[kind])
    @settings(max_examples=100, deadline=None)
    def law(made: tuple[bytes, Any]) -> None:
        raw, content = made
        assert same(DECODERS[kind](raw), content)
        assert same(DECODERS[kind](again(raw, kind)), content)

    law()
