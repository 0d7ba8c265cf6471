"""
The frames of an observation: the newest reading of a lidar and earlier ones.

No frame is older than its episode, whose first reading stands in for what was before. With 3
frames, 2 readings apart, these readings are seen after each of the first six (rows() of them)::

    reading    0      1      2      3      4      5
    frames   0 0 0  0 0 1  0 0 2  0 1 3  0 2 4  1 3 5

Where readings are not all kept, a window of the newest ones is: here 5, of which the first, the
third and the fifth are seen. begin() fills it with the first reading, push() adds one:

    window  00000  00001  00012  00123  01234  12345
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import torch
from torch import Tensor

EQUALLY_NEAR = 1e-6  # difference of two distances, in steps, that counts as none


def nearest_steps(duration: float, step: float) -> int:
    """Return the number of steps nearest to a duration, at least 1, the smaller of two; both s."""
    return max(1, math.ceil(duration / step - 0.5 - EQUALLY_NEAR))


@dataclass(frozen=True)
class Frames:
    """Number of frames of an observation, and the readings between them."""

    count: int
    spacing: int

    @property
    def window(self) -> int:
        """Return the number of readings in a row that hold all frames."""
        return (self.count - 1) * self.spacing + 1

    def rows(self, newest: Tensor, first: Tensor) -> Tensor:
        """
        Return the rows (..., K) of the frames among all readings, oldest first.

        newest (...) int64 is the row of the newest, first that in which its episode began.
        """
        offset = torch.arange(self.count - 1, -1, -1, device=newest.device) * self.spacing
        return torch.maximum(newest[..., None] - offset, first[..., None])

    def begin(self, ranges: Tensor) -> Tensor:
        """Return a window full of the first reading; (..., C, R) m -> (..., W, C, R) m."""
        window = (*ranges.shape[:-2], self.window, *ranges.shape[-2:])
        return ranges[..., None, :, :].expand(window).clone()

    def push(self, window: Tensor, ranges: Tensor) -> Tensor:
        """Return the window with the newest reading last; (..., W, C, R), (..., C, R) m."""
        return torch.cat([window[..., 1:, :, :], ranges[..., None, :, :]], dim=-3)

    def restart(self, window: Tensor, ranges: Tensor, begins: Tensor) -> Tensor:
        """Return windows (..., H, W, C, R) with those full of a reading that begin, (...) bool."""
        if not begins.any():
            return window
        return torch.where(begins[(..., *(None,) * 4)], self.begin(ranges), window)

    def select(self, window: Tensor) -> Tensor:
        """Return the frames of a window, newest last; (..., W, C, R) -> (..., K, C, R)."""
        return window[..., :: self.spacing, :, :]
