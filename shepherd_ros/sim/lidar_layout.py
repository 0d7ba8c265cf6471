"""
The layout of a scan: its channels and rays, readable without torch.

A channel of its own needs one entry, CHANNELS.add(Channel(name, meaning, discs=...)), and is cast
by lidars that name it in their option `others`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from shepherd_ros.config import ConfigError
from shepherd_ros.registry import Registry

# of a state of the world: centers (..., K, 2) m, radius (..., K) m, mask (..., K) bool
Discs = Callable[[Any], tuple[Any, Any, Any]]


@dataclass(frozen=True)
class Channel:
    """A type of bodies that a lidar sees; bodies of one type hide only each other."""

    name: str
    meaning: str
    color: str = '#C9A3D4'  # of its rays in pictures
    hit: str = '#7B3294'  # of their ends, and of markers
    discs: Discs | None = None  # what it sees; sim/lidar.py knows it of the paper's channels
    solid: bool = True  # bodies; the rays from inside others end at the rim
    hides: bool = False  # what is behind, of any type, where types hide each other


CHANNELS: Registry[Channel] = Registry('lidar channel')
_PAPER = (
    Channel('sheep', 'ranges to sheep', '#56B4E9', '#0072B2', hides=True),
    Channel('shepherds', 'ranges to other shepherds', '#E08A4B', '#D55E00', hides=True),
    Channel('goal', 'ranges to the rim of the goal region', '#6CC5A8', '#009E73', solid=False),
)
for _channel in _PAPER:
    CHANNELS.add(_channel)
PAPER_CHANNELS = tuple(channel.name for channel in _PAPER)  # which every lidar has, in this order
GOAL_CHANNEL = PAPER_CHANNELS.index('goal')


@dataclass(frozen=True)
class ScanLayout:
    """Layout of a scan: channels, the paper's first, and the number of rays of each."""

    channels: tuple[str, ...]
    n_rays: int

    @property
    def shape(self) -> tuple[int, int]:
        """Return the numbers of channels and rays."""
        return len(self.channels), self.n_rays

    def require(self, other: ScanLayout, source: str) -> None:
        """Raise ConfigError, which names the source of the scans, unless the layouts agree."""
        for name in other.channels:
            if name not in self.channels:
                raise ConfigError(
                    f'{source}: scans have no channel {name!r}, but {", ".join(self.channels)}: '
                    'expected those of the policy; cast it with the option others of the lidar'
                )
        if self.channels != other.channels:
            extra = next(name for name in self.channels if name not in other.channels)
            raise ConfigError(
                f'{source}: scans have a channel {extra!r}, expected {", ".join(other.channels)} '
                'as the policy; give it the option others of the lidar'
            )
        if self.n_rays != other.n_rays:
            raise ConfigError(f'{source}: scans have {self.n_rays} rays, expected {other.n_rays}')


def sorted_channels(names: Iterable[str]) -> tuple[str, ...]:
    """Return the paper's channels, then the other names in the order of the alphabet."""
    return (*PAPER_CHANNELS, *sorted(set(names) - set(PAPER_CHANNELS)))


def channel_of(name: str) -> Channel:
    """Return the entry of a channel; for an unknown one, an entry with its name alone."""
    return CHANNELS[name] if name in CHANNELS else Channel(name, name)
