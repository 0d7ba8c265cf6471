"""
Compiled forms of the heaviest laws for float32 on the CPU, tested equal to the plain ones.

Optional: used where numba is installed, unless the environment variable SHEPHERD_ROS_PLAIN is 1.
Each function stands behind the plain one of the same name, which says what it computes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
import math
import os
from typing import Any

import numpy as np
import torch
from torch import Tensor

try:
    from numba import njit
except ImportError:  # numba is optional
    njit = None

AVAILABLE = njit is not None and os.environ.get('SHEPHERD_ROS_PLAIN') != '1'


def usable(*tensors: Tensor) -> bool:
    """Return whether a compiled form exists for these tensors."""
    return AVAILABLE and all(
        t.dtype == torch.float32 and t.device.type == 'cpu' and not t.requires_grad
        for t in tensors
    )


def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function compiled at its first call, kept on disk; itself without numba."""
    return njit(cache=True, nogil=True)(function) if njit is not None else function


def flat(tensor: Tensor, keep: int) -> np.ndarray:
    """Return a tensor as a contiguous array with its leading axes made one, keep others left."""
    return tensor.reshape(-1, *tensor.shape[tensor.dim() - keep :]).contiguous().numpy()


@lru_cache(maxsize=16)
def _ray_table(n_rays: int) -> tuple[np.ndarray, np.ndarray]:
    """Return cosine and sine of each ray's angle, (n_rays,) float32."""
    theta = np.arange(n_rays) * (2 * math.pi / n_rays)
    return np.cos(theta).astype(np.float32), np.sin(theta).astype(np.float32)


@_compiled
def _cast(origin, center, radius, mask, cos, sin, range_max, touching, solid, out):  # type: ignore[no-untyped-def]
    n_rays = cos.shape[0]
    pitch = np.float32(2 * math.pi / n_rays)
    for p in range(origin.shape[0]):
        for k in range(center.shape[1]):
            if not mask[p, k]:
                continue
            x = center[p, k, 0] - origin[p, 0]
            y = center[p, k, 1] - origin[p, 1]
            r = radius[p, k]
            distance = np.float32(math.sqrt(x * x + y * y))
            if distance - r >= range_max:
                continue
            inside = distance <= r
            if inside:
                first, count = 0, n_rays
            else:
                angle = np.float32(math.atan2(y, x))
                half = np.float32(math.asin(min(r / distance, np.float32(1))))
                first = math.ceil((angle - half) / pitch)
                count = min(math.floor((angle + half) / pitch) - first + 1, n_rays)
            for i in range(count):
                ray = (first + i) % n_rays
                along = x * cos[ray] + y * sin[ray]
                if inside and solid:
                    hit = touching
                else:
                    across = x * sin[ray] - y * cos[ray]
                    depth = np.float32(math.sqrt(max(r * r - across * across, np.float32(0))))
                    hit = along + depth if inside else along - depth
                if hit < out[p, ray] and hit <= range_max:
                    out[p, ray] = hit


def cast_rays(
    origin: Tensor,
    centers: Tensor,
    radius: Tensor,
    mask: Tensor,
    n_rays: int,
    range_max: float,
    solid: bool,
    touching: float,
) -> Tensor:
    """Return ranges as sim.lidar.cast_rays() does."""
    cos, sin = _ray_table(n_rays)
    out = np.full((math.prod(origin.shape[:-1]), n_rays), np.inf, np.float32)
    shape = mask.shape
    _cast(
        flat(origin, 1),
        flat(centers.expand(*shape, 2), 2),
        flat(radius.expand(shape), 1),
        flat(mask, 1),
        cos,
        sin,
        np.float32(range_max),
        np.float32(touching),
        solid,
        out,
    )
    return torch.from_numpy(out).reshape(*origin.shape[:-1], n_rays)


@_compiled
def _strombom_forces(  # type: ignore[no-untyped-def]
    sheep, mask, shepherds, shepherd_mask, n_neighbors, sheep_range, shepherd_range, epsilon,
    from_sheep, center, from_shepherds, noticed,
):  # fmt: skip
    n = sheep.shape[1]
    squared = np.empty(n, np.float32)
    near = np.empty(n, np.float32)
    index = np.empty(n, np.int64)
    for b in range(sheep.shape[0]):
        present = 0
        sum_x, sum_y = np.float32(0), np.float32(0)
        for j in range(n):
            if mask[b, j]:
                present += 1
                sum_x += sheep[b, j, 0]
                sum_y += sheep[b, j, 1]
        far = present - 1 - n_neighbors
        keep = min(max(far, 0), n_neighbors)  # sheep on the shorter list
        sign = np.float32(-1) if far <= n_neighbors else np.float32(1)
        for i in range(n):
            x, y = sheep[b, i, 0], sheep[b, i, 1]
            for j in range(n):
                dx, dy = x - sheep[b, j, 0], y - sheep[b, j, 1]
                squared[j] = dx * dx + dy * dy
            push_x, push_y = np.float32(0), np.float32(0)
            for j in range(n):
                d2 = squared[j]
                if epsilon * epsilon < d2 < sheep_range * sheep_range and mask[b, j]:
                    inverse = np.float32(1) / np.float32(math.sqrt(d2))
                    push_x += (x - sheep[b, j, 0]) * inverse
                    push_y += (y - sheep[b, j, 1]) * inverse
            from_sheep[b, i, 0], from_sheep[b, i, 1] = push_x, push_y

            # the farthest of all others (sign -1) or the nearest (sign 1), by insertion
            found = 0
            for j in range(n if keep > 0 else 0):
                if j == i or not mask[b, j]:
                    continue
                key = sign * squared[j]
                if found == keep and key >= near[found - 1]:
                    continue
                k = found if found < keep else found - 1
                while k > 0 and near[k - 1] > key:
                    near[k], index[k] = near[k - 1], index[k - 1]
                    k -= 1
                near[k], index[k] = key, j
                if found < keep:
                    found += 1
            picked_x, picked_y = np.float32(0), np.float32(0)
            for k in range(found):
                picked_x += sheep[b, index[k], 0]
                picked_y += sheep[b, index[k], 1]
            count = min(present - 1, n_neighbors)
            if count <= 0:
                center[b, i, 0], center[b, i, 1] = x, y
            elif sign < 0:
                center[b, i, 0] = (sum_x - x - picked_x) / np.float32(count)
                center[b, i, 1] = (sum_y - y - picked_y) / np.float32(count)
            else:
                center[b, i, 0] = picked_x / np.float32(count)
                center[b, i, 1] = picked_y / np.float32(count)

            push_x, push_y = np.float32(0), np.float32(0)
            for h in range(shepherds.shape[1]):
                dx, dy = x - shepherds[b, h, 0], y - shepherds[b, h, 1]
                d2 = dx * dx + dy * dy
                if d2 < shepherd_range * shepherd_range and shepherd_mask[b, h]:
                    noticed[b, i] = True
                    if d2 > epsilon * epsilon:
                        inverse = np.float32(1) / np.float32(math.sqrt(d2))
                        push_x += dx * inverse
                        push_y += dy * inverse
            from_shepherds[b, i, 0], from_shepherds[b, i, 1] = push_x, push_y


def strombom_forces(
    sheep: Tensor,
    mask: Tensor,
    shepherds: Tensor,
    shepherd_mask: Tensor,
    n_neighbors: int,
    sheep_range: float,
    shepherd_range: float,
    epsilon: float,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return what sim.flocking.strombom.forces() does."""
    places = flat(sheep, 2)
    out = [np.empty_like(places) for _ in range(3)]
    noticed = np.zeros(places.shape[:2], np.bool_)
    _strombom_forces(
        places,
        flat(mask, 1),
        flat(shepherds, 2),
        flat(shepherd_mask, 1),
        n_neighbors,
        np.float32(sheep_range),
        np.float32(shepherd_range),
        np.float32(epsilon),
        *out,
        noticed,
    )
    push, center, fear = (torch.from_numpy(o).reshape(sheep.shape) for o in out)
    return push, center, fear, torch.from_numpy(noticed).reshape(mask.shape)
