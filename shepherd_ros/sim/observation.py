"""The network's input, made of frames: direction and layouts (paper, sections 3, 4)."""

from __future__ import annotations

from dataclasses import dataclass
import math

from shepherd_ros.config import Config, option
from shepherd_ros.sim.frames import Frames, nearest_steps
from shepherd_ros.sim.lidar_layout import GOAL_CHANNEL, PAPER_CHANNELS
import torch
from torch import Tensor

MAX_FRAME_INTERVAL = 1000.0  # [s]
LAYOUTS = ('types', 'frames', 'ring')


@dataclass(frozen=True)
class ObservationConfig(Config):
    """Options of the network's input from scans."""

    n_frames: int = option(3, 'frames that are seen together', low=1, high=64)
    frame_interval: float = option(
        0.5, 'seconds from one frame to the next', low=0.001, high=MAX_FRAME_INTERVAL
    )
    layout: str = option(
        'types',
        'types: channels are types, frames in a row; frames: the other way round; ring: both are '
        'channels',
        choices=LAYOUTS,
    )
    align: str = option(
        'world',
        'first ray of the input: world: along +x; goal: toward the middle of the goal, as the '
        'newest frame sees it, which makes all directions alike (choice: the paper names none)',
        choices=('world', 'goal'),
    )
    unit: float = option(
        0.0, 'ranges are divided by this [m]; 0: by range_max (choice)', low=0.0, high=1000.0
    )
    none_value: float = option(
        0.0,
        'input where a ray is free: 0 as in the paper, like a disc at hand; -1 like none; 1: '
        'range_max if unit is 0',
        low=-1.0,
    )
    range_min: float = option(
        0.0,
        'nearer readings count as this [m], so that a disc at hand is no free ray (choice)',
        low=0.0,
        sparse=True,
    )

    def frames(self, dt: float) -> Frames:
        """Return the frames of the observation, counted in steps of dt [s], the nearest number."""
        return Frames(self.n_frames, nearest_steps(self.frame_interval, dt))


def scaled_ranges(ranges: Tensor, config: ObservationConfig, range_max: float) -> Tensor:
    """Return ranges (...) m in the network's unit, at least range_min, free rays as none_value."""
    unit, none = config.unit or range_max, ~ranges.isfinite()
    if config.range_min:
        ranges = ranges.clamp(min=config.range_min)
    return torch.where(none, config.none_value, ranges / unit)


def first_ray(ranges: Tensor, config: ObservationConfig) -> Tensor:
    """
    Return the ray that comes first in the input; newest frame (..., C, R) m -> (...) int64.

    Toward the goal: the rays that see its disc, weighted by range, point to its middle on average,
    from outside and from inside alike. Ray 0 where it is not seen.
    """
    n_rays = ranges.shape[-1]
    if config.align == 'world':
        return torch.zeros(ranges.shape[:-2], dtype=torch.int64, device=ranges.device)
    goal_ranges = ranges[..., GOAL_CHANNEL, :]
    goal_ranges = torch.where(goal_ranges.isfinite(), goal_ranges, 0.0)
    pitch = 2 * math.pi / n_rays
    theta = torch.arange(n_rays, device=ranges.device, dtype=torch.float64) * pitch
    rays = torch.stack([theta.cos(), theta.sin()], dim=-1).to(ranges.dtype)
    toward = (goal_ranges[..., None] * rays).sum(dim=-2)  # by row: the same in every batch
    return torch.remainder(
        (torch.atan2(toward[..., 1], toward[..., 0]) / pitch).round().long(),
        n_rays,
    )


def arrange(stack: Tensor, first: Tensor, config: ObservationConfig) -> Tensor:
    """
    Return scaled frames (..., K, C, R) with ray first (...) in front, as (..., D, L).

    D, L are C, K R for layout types (oldest frame first); K, C R for frames; C K, R for ring.
    """
    if config.align != 'world':
        n_rays = stack.shape[-1]
        rays = torch.arange(n_rays, device=stack.device) + first[..., None]
        index = torch.remainder(rays, n_rays)[..., None, None, :].expand(stack.shape)
        stack = stack.gather(-1, index)
    if config.layout == 'types':
        return stack.transpose(-3, -2).flatten(-2)
    if config.layout == 'frames':
        return stack.flatten(-2)
    return stack.flatten(-3, -2)


def network_input(stack: Tensor, config: ObservationConfig, range_max: float) -> Tensor:
    """Return frames (..., K, C, R) m as the input (..., D, L) of a network."""
    first = first_ray(stack[..., -1, :, :], config)
    return arrange(scaled_ranges(stack, config, range_max), first, config)


def rotate_by_ray(vector: Tensor, first: Tensor, n_rays: int) -> Tensor:
    """Return vectors (..., 2) rotated by the angle of ray first (...): into the world frame."""
    angle = first * (2 * math.pi / n_rays)
    cos, sin = angle.cos().to(vector.dtype), angle.sin().to(vector.dtype)
    x, y = vector[..., 0], vector[..., 1]
    return torch.stack([x * cos - y * sin, x * sin + y * cos], dim=-1)


def input_shape(
    config: ObservationConfig, n_rays: int, types: int = len(PAPER_CHANNELS)
) -> tuple[int, int]:
    """Return the shape (D, L) of network_input() for scans with this number of channels."""
    frames = config.n_frames
    shapes = {
        'types': (types, frames * n_rays),
        'frames': (frames, types * n_rays),
        'ring': (types * frames, n_rays),
    }
    return shapes[config.layout]
