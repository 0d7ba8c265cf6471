"""The layout of a scan: its channels, which can be read without torch."""

from __future__ import annotations

from dataclasses import dataclass

from shepherd_ros.registry import Registry


@dataclass(frozen=True)
class Channel:
    """One type of what a lidar sees, with ranges of its own."""

    name: str
    meaning: str


CHANNELS: Registry[Channel] = Registry('lidar channel')
for _channel in (
    Channel('sheep', 'ranges to sheep'),
    Channel('shepherds', 'ranges to other shepherds'),
    Channel('goal', 'ranges to the rim of the goal region'),
):
    CHANNELS.add(_channel)
