"""Frames that are seen together, on numbers small enough to write down."""

from __future__ import annotations

import pytest
from shepherd_ros.sim import frames as module
from shepherd_ros.sim.frames import Frames
import torch
from torch import Tensor


def frame(first: float) -> Tensor:
    """Return ranges (3, 2) m: sheep, shepherds and goal on two rays."""
    return first + torch.tensor([[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]])


def test_the_first_reading_fills_the_whole_stack() -> None:
    stack = Frames(3, 1).begin(frame(7.0))
    assert stack.shape == (3, 3, 2)
    for k in range(3):
        assert torch.equal(stack[k], frame(7.0))


def test_the_newest_reading_comes_last_and_the_oldest_leaves() -> None:
    frames = Frames(3, 1)
    stack = frames.begin(frame(0.0))
    for first in (10.0, 20.0, 30.0, 40.0):
        stack = frames.push(stack, frame(first))
    assert torch.equal(stack, torch.stack([frame(20.0), frame(30.0), frame(40.0)]))


def test_pushing_does_not_change_the_stack_it_is_given() -> None:
    frames = Frames(2, 1)
    before = frames.begin(frame(0.0))
    stored = before.clone()
    frames.push(before, frame(10.0))
    assert torch.equal(before, stored)


def test_a_stack_of_one_frame_is_that_frame() -> None:
    frames = Frames(1, 1)
    stack = frames.push(frames.begin(frame(0.0)), frame(10.0))
    assert torch.equal(stack, frame(10.0)[None])


def test_the_example_of_the_docstring() -> None:
    frames, step = Frames(3, 2), torch.arange(6)
    rows = frames.rows(step, torch.zeros_like(step)).tolist()
    assert '  '.join(' '.join(map(str, row)) for row in rows) in str(module.__doc__)
    windows, window = [], frames.begin(frame(0.0))
    for t in range(6):
        window = frames.push(window, frame(float(t))) if t else window
        windows.append(''.join(f'{int(reading[0, 0])}' for reading in window))
        assert frames.select(window)[:, 0, 0].tolist() == rows[t]
    assert '  '.join(windows) in str(module.__doc__)


@pytest.mark.parametrize(('count', 'apart'), [(1, 1), (1, 4), (3, 1), (3, 4), (5, 2)])
def test_a_window_shows_the_rows_of_each_world_since_its_episode_began(
    count: int, apart: int
) -> None:
    frames, worlds, team = Frames(count, apart), 4, 2
    readings = torch.rand(25, worlds, team, 3, 8, generator=torch.Generator().manual_seed(1))
    first = torch.zeros(worlds, dtype=torch.int64)
    window = frames.begin(readings[0])
    for t in range(1, 25):
        begins = torch.tensor([False, t == 7, t % 5 == 0, True])
        first[begins] = t
        window = frames.restart(frames.push(window, readings[t]), readings[t], begins)
        rows = frames.rows(torch.full_like(first, t), first)
        for b in range(worlds):
            expected = readings[rows[b], b].transpose(0, 1)  # (H, K, 3, R)
            assert torch.equal(frames.select(window)[b], expected)
