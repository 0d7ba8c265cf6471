"""Frames: bytes of a state and back."""

from __future__ import annotations

import struct

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from shepherd_ros.console.state_frames import decode_frame, HEADER_BYTES, numbered, StateFrame


def frame_of(n: int, h: int, c: int, r: int, **others: object) -> StateFrame:
    """Return a frame of these sizes with numbers that float32 holds exactly."""
    rng = np.random.default_rng(n)

    def some(*shape: int) -> np.ndarray:
        return rng.integers(-999, 999, shape).astype(np.float32) / 8

    values = {
        'time': 12.5, 'episode': 3, 'step': 25, 'sheep': some(n, 2), 'sheep_heading': some(n, 2),
        'shepherds': some(h, 2), 'shepherd_heading': some(h, 2), 'driver': some(h),
        'goal': (1.5, -2.0), 'goal_radius': 4.0, 'lidar': 0, 'origin': (0.25, 8.0),
        'ranges': some(c, r),
    }  # fmt: skip
    return StateFrame(**(values | others))


@given(st.integers(1, 50), st.integers(1, 9), st.integers(0, 3), st.integers(0, 16))
def test_a_frame_comes_back_as_it_was(n: int, h: int, c: int, r: int) -> None:
    frame = frame_of(n, h, c, r)
    back = decode_frame(numbered(frame.encode(), 7))
    assert back.number == 7
    for name in ('time', 'episode', 'step', 'goal', 'goal_radius', 'lidar', 'origin'):
        assert getattr(back, name) == getattr(frame, name)
    for name in ('sheep', 'sheep_heading', 'shepherds', 'shepherd_heading', 'driver', 'ranges'):
        np.testing.assert_array_equal(getattr(back, name), getattr(frame, name))


def test_the_bytes_are_those_of_the_manual() -> None:
    ranges = np.array([[1.0, np.inf], [2.0, 3.0]], np.float32)
    raw = numbered(frame_of(3, 2, 2, 2, ranges=ranges).encode(), 2**32 + 9)
    assert len(raw) == HEADER_BYTES + 4 * (3 * 5 + 2 * 5 + 4)
    assert struct.unpack_from('<II', raw, 0) == (1, 9)
    assert struct.unpack_from('<d', raw, 8) == (12.5,)
    assert struct.unpack_from('<IIII', raw, 16) == (3, 25, 3, 2)
    assert struct.unpack_from('<iII', raw, 32) == (0, 2, 2)
    assert struct.unpack_from('<5f', raw, 44) == (1.5, -2.0, 4.0, 0.25, 8.0)
    assert struct.unpack_from('<4f', raw, len(raw) - 16) == (1.0, float('inf'), 2.0, 3.0)


def test_a_sheep_is_in_the_goal_up_to_its_rim() -> None:
    sheep = np.array([[4.0, 0.0], [4.0, 0.01], [-3.0, 0.0]])
    frame = frame_of(3, 1, 0, 0, sheep=sheep, goal=(0.0, 0.0), goal_radius=4.0)
    assert frame.in_goal.tolist() == [1.0, 0.0, 1.0]


def test_what_is_no_frame_is_refused() -> None:
    raw = frame_of(3, 2, 1, 4).encode()
    for wrong in (b'', raw[:63], raw[:-1], raw + b'0', b'\2' + raw[1:]):
        with pytest.raises(ValueError, match='expected'):
            decode_frame(wrong)
