"""Layouts of the input, on numbers small enough to write down."""

from __future__ import annotations

import math

import pytest
from reference import assert_near
from shepherd_ros.config import ConfigError
from shepherd_ros.sim.observation import (
    input_shape,
    LAYOUTS,
    network_input,
    ObservationConfig,
    scaled_ranges,
)
import torch
from torch import Tensor

INF = math.inf


def frame(first: float) -> Tensor:
    """Return ranges (3, 2) m: sheep, shepherds and goal on two rays."""
    return first + torch.tensor([[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]])


def stack_of_two() -> Tensor:
    """Return the older frame 0 to 5 and the newer 10 to 15."""
    return torch.stack([frame(0.0), frame(10.0)])


def test_layout_types_has_a_channel_per_type_with_the_frames_in_a_row_oldest_first() -> None:
    config = ObservationConfig(n_frames=2, layout='types')
    expected = [[0, 1, 10, 11], [2, 3, 12, 13], [4, 5, 14, 15]]
    assert_near(network_input(stack_of_two(), config, 1.0), expected, 0.0)


def test_layout_frames_has_a_channel_per_frame_with_the_types_in_a_row() -> None:
    config = ObservationConfig(n_frames=2, layout='frames')
    expected = [[0, 1, 2, 3, 4, 5], [10, 11, 12, 13, 14, 15]]
    assert_near(network_input(stack_of_two(), config, 1.0), expected, 0.0)


def test_layout_ring_has_a_channel_per_frame_and_type_with_the_rays_in_a_row() -> None:
    config = ObservationConfig(n_frames=2, layout='ring')
    expected = [[0, 1], [2, 3], [4, 5], [10, 11], [12, 13], [14, 15]]
    result = network_input(stack_of_two(), config, 1.0)
    assert sorted(result.tolist()) == [[float(v) for v in row] for row in expected]
    assert_near(result, expected, 0.0)


@pytest.mark.parametrize('layout', LAYOUTS)
def test_ranges_are_in_units_of_the_greatest_and_free_rays_have_a_value_of_their_own(
    layout: str,
) -> None:
    ranges = torch.tensor([[75.0, INF], [37.5, 0.75], [INF, INF]])
    for none in (0.0, 1.0):
        config = ObservationConfig(n_frames=1, layout=layout, none_value=none)
        result = network_input(ranges[None], config, 75.0)
        assert_near(result.flatten(), [1.0, none, 0.5, 0.01, none, none], 1e-6)


def test_a_disc_at_hand_is_no_free_ray_with_a_nearest_range_and_a_value_for_none() -> None:
    ranges = torch.tensor([INF, 0.01, 1.4, 1.5, 20.0, 75.0])
    paper = scaled_ranges(ranges, ObservationConfig(), 75.0)
    assert_near(paper, [0.0, 0.01 / 75, 1.4 / 75, 0.02, 20 / 75, 1.0], 1e-6)
    config = ObservationConfig(unit=10.0, range_min=1.5, none_value=-1.0)
    assert_near(scaled_ranges(ranges, config, 75.0), [-1.0, 0.15, 0.15, 0.15, 2.0, 7.5], 1e-6)


@pytest.mark.parametrize('layout', LAYOUTS)
@pytest.mark.parametrize('n_frames', [1, 3])
def test_the_announced_shape_is_that_of_the_input_for_any_leading_axes(
    layout: str, n_frames: int
) -> None:
    config = ObservationConfig(n_frames=n_frames, layout=layout)
    ranges = torch.rand(4, 5, 3, 16, generator=torch.Generator().manual_seed(0))
    frames = config.frames(0.5)
    stack = frames.push(frames.begin(ranges), ranges * 2)
    result = network_input(stack, config, 75.0)
    assert result.shape == (4, 5, *input_shape(config, 16))
    assert torch.equal(result[2, 3], network_input(stack[2, 3], config, 75.0))


def test_the_input_of_the_paper_is_three_channels_of_1536() -> None:
    assert input_shape(ObservationConfig(), 512) == (3, 1536)
    assert input_shape(ObservationConfig(layout='frames'), 512) == (3, 1536)
    assert input_shape(ObservationConfig(layout='ring'), 512) == (9, 512)


def test_an_unknown_layout_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(ConfigError, match=r"layout is 'type'.*did you mean 'types'\?"):
        ObservationConfig(layout='type')
