"""Types of topics: a process has one for each."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

# Jazzy has no public name for the errors of rcl
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from shepherd_ros.config import ConfigError


@contextmanager
def one_type(topic: str, kind: str) -> Iterator[None]:
    """Raise ConfigError where this process has a topic with another type."""
    try:
        yield
    except _rclpy.RCLError as error:
        if 'incompatible type' not in str(error):
            raise
        raise ConfigError(
            f'{topic} is {kind} for one node and another type for a node of the same process: '
            'expected one type; give them the same value of stamped, or a process each'
        ) from None
