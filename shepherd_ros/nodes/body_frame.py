"""Yaw of the shepherds, for commands in their own frames (no rclpy, no torch)."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
from shepherd_ros.nodes.command_mux import Velocity
from shepherd_ros.wire.decode import Floats


class BodyFrames:
    """
    The yaw of each shepherd: the direction of its last move, or what was steered.

    Where the last command was in the frame of the body, that alone turns it: so a shepherd that
    is driven backwards, or sideways, goes on to look where it looked.
    """

    def __init__(self) -> None:
        """Begin without a shepherd."""
        self.yaw: list[float] = []  # [rad] of each
        self.position: Floats = np.zeros((0, 2))

    def begin(self, position: Floats, heading: Floats) -> None:
        """Take positions (H, 2) m and headings (H, 2) as they are."""
        self.position = position
        self.yaw = [math.atan2(y, x) for x, y in heading]

    def move(
        self, position: Floats, heading: Floats, turn: Sequence[float | None], dt: float
    ) -> None:
        """
        Follow a step of dt [s] to positions (H, 2) m.

        turn [rad/s] is that of each shepherd's last command if it was in the frame of the body.
        """
        if len(position) != len(self.yaw):
            self.begin(position, heading)
            return
        for h, (x, y) in enumerate(position - self.position):
            rate = turn[h]
            if rate is not None:
                self.yaw[h] = math.remainder(self.yaw[h] + rate * dt, 2 * math.pi)
            elif x or y:
                self.yaw[h] = math.atan2(y, x)
        self.position = position

    def to_world(self, shepherd: int, velocity: Velocity) -> tuple[float, float]:
        """Return a velocity (forward, to the left) of a shepherd in the world frame [m/s]."""
        forward, left, _ = velocity
        cos, sin = math.cos(self.yaw[shepherd]), math.sin(self.yaw[shepherd])
        return forward * cos - left * sin, forward * sin + left * cos
