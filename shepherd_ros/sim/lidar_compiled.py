"""The lidar of sim.lidar, ray by covered ray."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from functools import lru_cache
import math

import numpy as np
from shepherd_ros.sim.compiled import compiled, flat_array
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor


@lru_cache(maxsize=16)
def _ray_table(n_rays: int) -> tuple[np.ndarray, np.ndarray]:
    """Return cosine and sine of each ray's angle, (n_rays,) float32."""
    theta = np.arange(n_rays) * (2 * math.pi / n_rays)
    return np.cos(theta).astype(np.float32), np.sin(theta).astype(np.float32)


@compiled
def _scan_disc(x, y, radius, cos, sin, range_max, contact_range, behind, out):
    """
    Lower the ranges (R,) to a disc at x, y; contact_range < 0: the rim seen from inside.

    Rays of which the middle is more than `behind` [m] behind the sensor do not return from inside.
    """
    n_rays = cos.shape[0]
    distance = np.float32(math.sqrt(x * x + y * y))
    if distance - radius >= range_max:
        return
    inside = distance <= radius
    if inside:
        first, count = 0, n_rays
    else:
        pitch = np.float32(2 * math.pi / n_rays)
        angle = np.float32(math.atan2(y, x))
        half = np.float32(math.asin(min(radius / distance, np.float32(1))))
        first = math.ceil((angle - half) / pitch)
        count = min(math.floor((angle + half) / pitch) - first + 1, n_rays)
    for i in range(count):
        ray = (first + i) % n_rays
        across = x * sin[ray] - y * cos[ray]
        depth = np.float32(math.sqrt(max(radius * radius - across * across, np.float32(0))))
        along = x * cos[ray] + y * sin[ray]
        hit = along - depth
        if inside:
            if contact_range >= 0 and along < -behind:
                continue
            hit = contact_range if contact_range >= 0 else along + depth
        if hit < out[ray] and hit <= range_max:
            out[ray] = hit


@compiled
def _scan(
    sheep, sheep_mask, shepherds, shepherd_mask, goal, goal_radius, chosen, sheep_radius,
    shepherd_radius, cos, sin, range_max, contact_range, behind, out,
):  # fmt: skip
    for b in range(sheep.shape[0]):
        for s in range(chosen.shape[0]):
            sensor = chosen[s]
            if not shepherd_mask[b, sensor]:
                continue
            x, y = shepherds[b, sensor, 0], shepherds[b, sensor, 1]
            for i in range(sheep.shape[1]):
                if sheep_mask[b, i]:
                    _scan_disc(
                        sheep[b, i, 0] - x, sheep[b, i, 1] - y, sheep_radius,
                        cos, sin, range_max, contact_range, behind, out[b, s, 0],
                    )  # fmt: skip
            for h in range(shepherds.shape[1]):
                if shepherd_mask[b, h] and h != sensor:
                    _scan_disc(
                        shepherds[b, h, 0] - x, shepherds[b, h, 1] - y, shepherd_radius,
                        cos, sin, range_max, contact_range, behind, out[b, s, 1],
                    )  # fmt: skip
            _scan_disc(
                goal[b, 0] - x, goal[b, 1] - y, goal_radius[b],
                cos, sin, range_max, np.float32(-1), behind, out[b, s, 2],
            )  # fmt: skip


def scan_discs(
    state: WorldState,
    chosen: Tensor,
    sheep_radius: float,
    shepherd_radius: float,
    n_rays: int,
    range_max: float,
    contact_range: float,
    behind: float,
) -> Tensor:
    """Return the ranges (..., S, 3, R) m of the paper's channels, as sim.lidar does."""
    batch, shape = state.step.shape, (len(chosen), len(PAPER_CHANNELS), n_rays)
    cos, sin = _ray_table(n_rays)
    out = np.full((state.step.numel(), *shape), np.inf, np.float32)
    _scan(
        flat_array(state.sheep, 2),
        flat_array(state.sheep_mask, 1),
        flat_array(state.shepherds, 2),
        flat_array(state.shepherd_mask, 1),
        flat_array(state.goal, 1),
        flat_array(state.goal_radius, 0),
        chosen.numpy(),
        np.float32(sheep_radius),
        np.float32(shepherd_radius),
        cos,
        sin,
        np.float32(range_max),
        np.float32(contact_range),
        np.float32(behind),
        out,
    )
    return torch.from_numpy(out).reshape(*batch, *shape)
