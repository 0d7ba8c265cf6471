"""The buffer of commands: who has answered, who is late."""

from __future__ import annotations

import math

from shepherd_ros.nodes.pending_commands import CommandBuffer


def test_a_new_buffer_waits_for_everybody() -> None:
    buffer = CommandBuffer(3)
    assert not buffer.complete
    assert buffer.silent() == [0, 1, 2]
    assert buffer.velocities == [(0.0, 0.0)] * 3


def test_the_buffer_is_complete_once_everybody_has_answered() -> None:
    buffer = CommandBuffer(2)
    buffer.add(1, (0.5, -0.5))
    assert not buffer.complete
    assert buffer.silent() == [0]
    buffer.add(0, (1.0, 0.0))
    assert buffer.complete
    assert buffer.velocities == [(1.0, 0.0), (0.5, -0.5)]


def test_a_later_answer_replaces_an_earlier_one() -> None:
    buffer = CommandBuffer(1)
    buffer.add(0, (1.0, 0.0))
    buffer.add(0, (0.0, 2.0))
    assert buffer.velocities == [(0.0, 2.0)]


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
        ages.append((buffer.age[0], buffer.held(3)))
        buffer.expect()
    stored, stopped = [(1.0, 2.0), (0.0, 0.0)], [(0.0, 0.0)] * 2
    assert ages == [(0, stored), (1, stored), (2, stored), (3, stored), (4, stopped)]
    buffer.add(0, (3.0, 0.0))  # it wakes up
    assert buffer.held(3) == [(3.0, 0.0), (0.0, 0.0)]


def test_a_watchdog_of_zero_steps_takes_only_answers_to_the_present_state() -> None:
    buffer = CommandBuffer(1)
    buffer.add(0, (1.0, 0.0))
    assert buffer.held(0) == [(1.0, 0.0)]
    buffer.expect()
    assert buffer.held(0) == [(0.0, 0.0)]


def test_a_shepherd_that_never_spoke_never_moves_whatever_the_watchdog() -> None:
    buffer = CommandBuffer(1)
    for _ in range(3):
        buffer.expect()
    assert buffer.held(2**29) == [(0.0, 0.0)]


def test_a_nan_in_a_command_is_kept_for_the_world_to_refuse() -> None:
    buffer = CommandBuffer(1)
    buffer.add(0, (math.nan, math.inf))
    assert buffer.complete
    assert all(not math.isfinite(part) for part in buffer.velocities[0])
