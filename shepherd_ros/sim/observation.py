"""From scans to the network's input: frame stack and layouts (paper, sections 3 and 4)."""

from __future__ import annotations

from dataclasses import dataclass

from shepherd_ros.config import Config, option
from shepherd_ros.sim.lidar import CHANNELS
import torch
from torch import Tensor

LAYOUTS = ('types', 'frames', 'ring')


@dataclass(frozen=True)
class ObservationConfig(Config):
    """How scans become the input of a network."""

    n_frames: int = option(3, 'last steps that are seen together', low=1, high=64)
    layout: str = option(
        'types',
        'types: channels are types, frames in a row; frames: the other way round; ring: both are '
        'channels',
        choices=LAYOUTS,
    )
    none_value: float = option(
        0.0, 'input where a ray is free, in units of range_max: 0 as in the paper, or 1', low=0.0
    )


def first_stack(ranges: Tensor, n_frames: int) -> Tensor:
    """Return a stack filled with the first reading; (..., 3, R) m -> (..., K, 3, R) m."""
    return ranges[..., None, :, :].expand(*ranges.shape[:-2], n_frames, *ranges.shape[-2:]).clone()


def push_frame(stack: Tensor, ranges: Tensor) -> Tensor:
    """Return the stack with the newest reading last; (..., K, 3, R), (..., 3, R) m."""
    return torch.cat([stack[..., 1:, :, :], ranges[..., None, :, :]], dim=-3)


def network_input(stack: Tensor, config: ObservationConfig, range_max: float) -> Tensor:
    """
    Return the stack in units of range_max, with free rays as none_value.

    (..., K, 3, R) m -> (..., C, L), where
    C, L are 3, K R for layout types (oldest frame first); K, 3 R for frames; 3 K, R for ring.
    """
    scaled = torch.where(stack.isfinite(), stack / range_max, config.none_value)
    if config.layout == 'types':
        return scaled.transpose(-3, -2).flatten(-2)
    if config.layout == 'frames':
        return scaled.flatten(-2)
    return scaled.flatten(-3, -2)


def input_shape(config: ObservationConfig, n_rays: int) -> tuple[int, int]:
    """Return channels and length of network_input()."""
    frames, types = config.n_frames, len(CHANNELS)
    shapes = {
        'types': (types, frames * n_rays),
        'frames': (frames, types * n_rays),
        'ring': (types * frames, n_rays),
    }
    return shapes[config.layout]
