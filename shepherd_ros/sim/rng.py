"""
Random numbers as a pure function of (seed, step, stream, index).

A counter-based generator (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3") with
the 64-bit mixer of splitmix64 (Steele, Lea and Flood 2014). A world draws the same numbers alone
and in a batch, on the CPU and on the GPU, in one process and spread over nodes, from its start or
resumed at any step.
"""

from __future__ import annotations

from enum import IntEnum
import math

import numpy as np
from numpy.random import SeedSequence
import torch
from torch import Tensor


def _signed(constant: int) -> int:
    """Return the int64 with the same bits as an unsigned 64-bit constant."""
    return constant - (1 << 64) if constant >= 1 << 63 else constant


_GOLDEN = _signed(0x9E3779B97F4A7C15)
_MIX_1 = _signed(0xBF58476D1CE4E5B9)
_MIX_2 = _signed(0x94D049BB133111EB)


class Stream(IntEnum):
    """Purpose of a random number; numbers of different streams are independent."""

    FLOCK_PLACE = 1
    SHEPHERD_PLACE = 2
    SHEEP_POSITION = 3
    SHEPHERD_POSITION = 4
    HEADING = 5
    GOAL_RADIUS = 6
    N_SHEPHERDS = 7
    GRAZE = 8
    TURN = 9
    GOAL_NOISE = 10
    SHEEP_NOISE = 11
    SHEPHERD_NOISE = 12
    RANGE_NOISE = 13
    DROPOUT = 14
    CONTROL = 15
    ACTION = 16
    GOAL_COURSE = 17
    PEDESTRIAN_SPEED = 18
    PEDESTRIAN_TARGET = 19


FIRST_MIXED = 1 << 52  # lowest of mixed_seeds(); what is held out has seeds below
_MASK = (1 << 64) - 1


def mixed_seeds(count: int, *key: int) -> Tensor:
    """
    Return seeds (count,) int64 of independent episodes: the k-th is a function of key and k.

    They are mixed as numpy.random.SeedSequence does, and lie in [2**52, 2**53).
    """
    words = SeedSequence([k & _MASK for k in key]).generate_state(count, np.uint64)
    return torch.from_numpy((words >> np.uint64(12)).astype(np.int64) + FIRST_MIXED)


def _mix(z: Tensor) -> Tensor:
    """Return the bits of an int64 tensor thoroughly mixed (a bijection)."""
    z = (z ^ ((z >> 30) & 0x3FFFFFFFF)) * _MIX_1
    z = (z ^ ((z >> 27) & 0x1FFFFFFFFF)) * _MIX_2
    return z ^ ((z >> 31) & 0x1FFFFFFFF)


def random_bits(seed: Tensor, step: Tensor, stream: Stream, index: Tensor) -> Tensor:
    """Return 64 random bits; seed, step (...,) int64, index (K...,) int64 -> (..., K...) int64."""
    key = _mix(_mix(seed + _GOLDEN) + step * _GOLDEN + int(stream))
    key = key[(...,) + (None,) * index.dim()]
    return _mix(key + (index + 1) * _GOLDEN)


def uniform(
    seed: Tensor, step: Tensor, stream: Stream, index: Tensor, dtype: torch.dtype = torch.float32
) -> Tensor:
    """Return numbers in [0, 1), multiples of 2^-24; shapes as in random_bits()."""
    bits = random_bits(seed, step, stream, index)
    return ((bits >> 40) & 0xFFFFFF).to(dtype) * 2.0**-24


def normal(
    seed: Tensor, step: Tensor, stream: Stream, index: Tensor, dtype: torch.dtype = torch.float32
) -> Tensor:
    """Return standard normal numbers (Box and Muller 1958); shapes as in random_bits()."""
    bits = random_bits(seed, step, stream, index)
    radius = (((bits >> 40) & 0xFFFFFF) + 1).to(dtype) * 2.0**-24
    angle = ((bits >> 16) & 0xFFFFFF).to(dtype) * (2.0**-24 * 2 * math.pi)
    return torch.sqrt(-2 * torch.log(radius)) * torch.cos(angle)


def direction(
    seed: Tensor, step: Tensor, stream: Stream, index: Tensor, dtype: torch.dtype = torch.float32
) -> Tensor:
    """Return uniformly random unit vectors; as random_bits(), with a last axis of 2."""
    angle = uniform(seed, step, stream, index, dtype) * (2 * math.pi)
    return torch.stack([torch.cos(angle), torch.sin(angle)], dim=-1)
