"""Vectors in the plane, last axis 2."""

from __future__ import annotations

import math

import torch
from torch import Tensor

# Unit vectors that cancel exactly sum to about 1e-7 in float32: shorter than this is none.
EPSILON = 1e-6


def unit(vector: Tensor) -> Tensor:
    """Return vector / |vector|, and 0 where |vector| < EPSILON; (..., 2) -> (..., 2)."""
    length = torch.linalg.vector_norm(vector, dim=-1, keepdim=True)
    return torch.where(length < EPSILON, 0.0, vector / length.clamp(min=EPSILON))


def clip_norm(vector: Tensor, max_norm: float) -> Tensor:
    """Return the vector cut to max_norm, direction kept; (..., 2) -> (..., 2)."""
    length = torch.hypot(vector[..., :1], vector[..., 1:])  # does not overflow
    return torch.where(length > max_norm, vector * (max_norm / length.clamp(min=EPSILON)), vector)


def bearing(vector: Tensor) -> Tensor:
    """Return the angle from +x, counter-clockwise, in [-pi, pi] rad; (..., 2) -> (...)."""
    return torch.atan2(vector[..., 1], vector[..., 0])


def from_bearing(angle: Tensor) -> Tensor:
    """Return the unit vector at an angle; (...) rad -> (..., 2)."""
    return torch.stack([torch.cos(angle), torch.sin(angle)], dim=-1)


def wrap(angle: Tensor) -> Tensor:
    """Return the angle in [-pi, pi); (...) rad."""
    return torch.remainder(angle + math.pi, 2 * math.pi) - math.pi


def masked_mean(vector: Tensor, mask: Tensor) -> Tensor:
    """Return the mean over the present agents; (..., K, 2), (..., K) bool -> (..., 2)."""
    total = (vector * mask[..., None]).sum(dim=-2)
    return total / mask.sum(dim=-1, keepdim=True).clamp(min=1)
