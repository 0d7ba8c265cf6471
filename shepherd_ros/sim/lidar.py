"""The shepherds' lidar: ranges to discs, a channel for each type (paper, section 3)."""

from __future__ import annotations

from dataclasses import dataclass
import math

from shepherd_ros.config import Config, ConfigError, option
from shepherd_ros.sim.compiled import compilable
from shepherd_ros.sim.fused import fused, fusible
from shepherd_ros.sim.lidar_compiled import scan_discs
from shepherd_ros.sim.lidar_layout import CHANNELS, ScanLayout, sorted_channels
from shepherd_ros.sim.rng import normal, Stream, uniform
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor

CONTACT_RANGE = 0.01  # [m] to a body that overlaps the sensor: not 0, which stands for none seen
FACING_SLACK = 1e-6  # [m] so that rays across, and all of a sensor in the very middle, face it


@dataclass(frozen=True)
class LidarConfig(Config):
    """A lidar with a channel per type; bodies hide only their own type, unless told."""

    n_rays: int = option(512, 'rays, evenly spread, ray 0 along +x', low=4, high=65536)
    range_max: float = option(75.0, 'nothing farther is seen [m]', low=0.1)
    sheep_radius: float = option(0.5, 'radius of the disc of a sheep [m] (choice)', low=0.001)
    shepherd_radius: float = option(
        0.5, 'radius of the disc of a shepherd [m] (choice)', low=0.001
    )
    cross_occlusion: bool = option(False, 'sheep and shepherds hide what is behind, of any type')
    range_noise: float = option(0.0, 'standard deviation of a range [m]', low=0.0)
    dropout: float = option(
        0.0, 'chance that a ray of a channel returns nothing', low=0.0, high=1.0
    )
    contact: str = option(
        'all',
        'rays that return from a body that overlaps the sensor: all, or those facing its middle, '
        'within 90 degrees, as from its rim (choice)',
        choices=('all', 'facing'),
        sparse=True,
    )
    others: str = option(
        '',
        'channels of plug-ins beside sheep, shepherds and goal, with commas between',
        sparse=True,
    )

    def __post_init__(self) -> None:
        """Check each field and the names of the channels."""
        super().__post_init__()
        names = sorted({name.strip() for name in self.others.split(',')} - {''})
        known = [name for name, channel in CHANNELS.items() if channel.discs is not None]
        if not set(names) <= set(known):
            raise ConfigError(
                f'others is {self.others!r}: expected channels of plug-ins, '
                f'{", ".join(known) or "of which there are none"}'
            )
        object.__setattr__(self, 'others', ','.join(names))

    @property
    def layout(self) -> ScanLayout:
        """Return the channels and rays of its scans."""
        return ScanLayout(sorted_channels(filter(None, self.others.split(','))), self.n_rays)


def cast_rays(
    origin: Tensor, centers: Tensor, radius: Tensor, mask: Tensor,
    n_rays: int, range_max: float, solid: bool = True, facing: bool = False,
) -> Tensor:  # fmt: skip
    """
    Return the range to the nearest disc along each ray, +inf where a ray is free.

    origin (..., 2) m, centers (..., K, 2) m, radius (..., K) m, mask (..., K) bool (False: not
    there) -> (..., n_rays) m, world frame; ray k points along 2 pi k / n_rays, counter-clockwise
    from +x. From inside a solid disc every ray, or each that faces its middle, returns
    CONTACT_RANGE; from inside one that is not, its rim. Only the rays that a disc covers, an
    interval of angles, are computed.
    """
    batch, pitch = origin.shape[:-1], 2 * math.pi / n_rays
    offset = centers - origin[..., None, :]
    x, y, radius, mask = (
        t.expand(mask.shape).reshape(-1) for t in (offset[..., 0], offset[..., 1], radius, mask)
    )
    distance = torch.hypot(x, y)
    in_range = mask & (distance - radius < range_max)
    sensor = torch.arange(math.prod(batch), device=origin.device)
    sensor = sensor.repeat_interleave(centers.shape[-2])[in_range]
    x, y, radius, distance = x[in_range], y[in_range], radius[in_range], distance[in_range]

    inside = distance <= radius
    angle = torch.atan2(y, x)
    half = torch.asin((radius / distance.clamp(min=1e-12)).clamp(max=1.0))
    first = torch.ceil((angle - half) / pitch).long()
    last = torch.floor((angle + half) / pitch).long()
    count = torch.where(inside, n_rays, (last - first + 1).clamp(min=0, max=n_rays))
    disc = torch.arange(count.shape[0], device=count.device).repeat_interleave(count)
    start = (count.cumsum(0) - count)[disc]
    ray = torch.remainder(
        first[disc] + torch.arange(disc.shape[0], device=disc.device) - start, n_rays
    )

    theta = torch.arange(n_rays, device=origin.device, dtype=torch.float64) * pitch
    cos, sin = theta.cos().to(x.dtype)[ray], theta.sin().to(x.dtype)[ray]
    x, y, radius, inside = x[disc], y[disc], radius[disc], inside[disc]
    along, across = x * cos + y * sin, x * sin - y * cos
    depth = (radius * radius - across * across).clamp(min=0).sqrt()
    rim = torch.full_like(along, CONTACT_RANGE) if solid else along + depth
    distance = torch.where(inside, rim, along - depth)
    if solid and facing:
        distance = torch.where(inside & (along < -FACING_SLACK), torch.inf, distance)
    ranges = torch.full((math.prod(batch) * n_rays,), torch.inf, dtype=x.dtype, device=x.device)
    ranges.scatter_reduce_(0, sensor[disc] * n_rays + ray, distance, 'amin')
    return ranges.masked_fill_(ranges > range_max, torch.inf).reshape(*batch, n_rays)


@fused
def cast_all_rays(
    origin: Tensor,
    centers: Tensor,
    radius: Tensor,
    mask: Tensor,
    n_rays: int,
    range_max: float,
    solid: bool = True,
    facing: bool = False,
) -> Tensor:
    """
    Return the ranges of cast_rays(), from a test of each ray against each disc.

    Slow, and large in memory, unless compiled. It is for torch.compile on a GPU, as none of its
    shapes depends on values.
    """
    offset = centers - origin[..., None, :]
    x, y = offset[..., None].unbind(dim=-2)  # (..., K, 1)
    radius = radius[..., None]
    ray = torch.arange(n_rays, device=origin.device, dtype=torch.float64)
    theta = ray * (2 * math.pi / n_rays)
    cos, sin = theta.cos().to(x.dtype), theta.sin().to(x.dtype)
    along, across = x * cos + y * sin, x * sin - y * cos
    depth = (radius * radius - across * across).clamp(min=0).sqrt()
    inside = torch.hypot(x, y) <= radius
    ahead = (across.abs() <= radius) & (along > 0)
    rim = torch.full_like(along, CONTACT_RANGE) if solid else along + depth
    distance = torch.where(inside, rim, along - depth)
    if solid and facing:
        inside = inside & (along >= -FACING_SLACK)
    hit = (inside | ahead) & mask[..., None] & (distance <= range_max)
    return torch.where(hit, distance, torch.inf).amin(dim=-2)


def scan(state: WorldState, config: LidarConfig, shepherds: Tensor | None = None) -> Tensor:
    """
    Return the ranges of the shepherds' lidars, (..., S, C, n_rays) m, +inf on free rays.

    Channels are those of the layout, rays are aligned with the world. shepherds (S,) int64 names
    those whose lidars are read, all by default. An absent shepherd sees nothing.
    """
    if shepherds is None:
        shepherds = torch.arange(state.shepherds.shape[-2], device=state.shepherds.device)
    ranges = _discs(state, config, shepherds)
    if config.others:
        added = [
            _plugin_channel(state, config, shepherds, name) for name in config.others.split(',')
        ]
        ranges = torch.cat([ranges, torch.stack(added, dim=-2)], dim=-2)
    return _with_faults(state, config, shepherds, ranges)


def _discs(state: WorldState, config: LidarConfig, shepherds: Tensor) -> Tensor:
    """Return the paper's channels of a lidar without faults, whose types hide nothing else."""
    if compilable(state.sheep, state.shepherds):
        return scan_discs(
            state, shepherds, config.sheep_radius, config.shepherd_radius, config.n_rays,
            config.range_max, CONTACT_RANGE,
            FACING_SLACK if config.contact == 'facing' else torch.inf,
        )  # fmt: skip
    indices = torch.arange(state.shepherds.shape[-2], device=shepherds.device)

    def channel(centers: Tensor, radius: Tensor, mask: Tensor, solid: bool = True) -> Tensor:
        return _channel(state, config, shepherds, (centers, radius, mask), solid)

    def size(radius: float) -> Tensor:
        return torch.tensor(radius, dtype=state.sheep.dtype, device=state.sheep.device)

    sheep = channel(state.sheep, size(config.sheep_radius), state.sheep_mask[..., None, :])
    others = state.shepherd_mask[..., None, :] & (indices != shepherds[:, None])  # not itself
    team = channel(state.shepherds, size(config.shepherd_radius), others)
    radius = state.goal_radius[..., None, None]
    goal = channel(
        state.goal[..., None, :], radius, torch.ones_like(radius, dtype=torch.bool), solid=False
    )
    return torch.stack([sheep, team, goal], dim=-2)


def _channel(
    state: WorldState,
    config: LidarConfig,
    shepherds: Tensor,
    discs: tuple[Tensor, Tensor, Tensor],
    solid: bool,
) -> Tensor:
    """Return the ranges (..., S, R) m to discs: centers (..., K, 2), radii, mask (..., S, K)."""
    centers, radius, mask = discs
    origin = state.shepherds[..., shepherds, :]
    present = state.shepherd_mask[..., shepherds, None]  # (..., S, 1)
    mask = (mask & present).expand(*origin.shape[:-1], centers.shape[-2])
    return (cast_all_rays if fusible(origin) else cast_rays)(
        origin, centers[..., None, :, :], radius, mask, config.n_rays, config.range_max, solid,
        config.contact == 'facing',
    )  # fmt: skip


def _plugin_channel(
    state: WorldState, config: LidarConfig, shepherds: Tensor, name: str
) -> Tensor:
    """Return the ranges of a channel of a plug-in, (..., S, R) m."""
    channel = CHANNELS[name]
    assert channel.discs is not None, name
    centers, radius, mask = channel.discs(state)
    discs = centers, radius[..., None, :], mask[..., None, :]
    return _channel(state, config, shepherds, discs, channel.solid)


def _with_faults(
    state: WorldState, config: LidarConfig, shepherds: Tensor, ranges: Tensor
) -> Tensor:
    """Return the ranges (..., S, C, R) m with occlusion between types, noise and dropout."""
    if config.cross_occlusion:
        bodies = [k for k, name in enumerate(config.layout.channels) if CHANNELS[name].hides]
        nearest_body = ranges[..., bodies, :].amin(dim=-2, keepdim=True)
        ranges = torch.where(ranges > nearest_body, torch.inf, ranges)
    if config.range_noise == 0 and config.dropout == 0:
        return ranges
    index = torch.arange(ranges.shape[-2] * config.n_rays, device=ranges.device)
    index = (shepherds[:, None] * index.shape[0] + index).unflatten(-1, ranges.shape[-2:])
    draws = normal(state.seed, state.step, Stream.RANGE_NOISE, index, ranges.dtype)
    ranges = (ranges + config.range_noise * draws).clamp(min=CONTACT_RANGE)
    dropped = uniform(state.seed, state.step, Stream.DROPOUT, index, ranges.dtype) < config.dropout
    return torch.where(dropped | (ranges > config.range_max), torch.inf, ranges)
