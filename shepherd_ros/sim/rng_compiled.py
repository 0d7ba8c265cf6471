"""The counter-based random numbers of sim.rng, one at a time."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np
from shepherd_ros.sim.compiled import compiled

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_24_BITS = np.uint64(0xFFFFFF)


@compiled
def mix(z):
    """Return 64 bits thoroughly mixed."""
    z = (z ^ (z >> np.uint64(30))) * _MIX_1
    z = (z ^ (z >> np.uint64(27))) * _MIX_2
    return z ^ (z >> np.uint64(31))


@compiled
def stream_key(seed, step, stream):
    """Return the key of a world's stream at a step; int64 each."""
    return mix(mix(np.uint64(seed) + _GOLDEN) + np.uint64(step) * _GOLDEN + np.uint64(stream))


@compiled
def uniform_at(key, index):
    """Return the uniform number in [0, 1) at an index of a stream, float32."""
    bits = mix(key + np.uint64(index + 1) * _GOLDEN)
    return np.float32((bits >> np.uint64(40)) & _24_BITS) * np.float32(2.0**-24)


@compiled
def direction_at(key, index):
    """Return the random unit vector at an index of a stream, x and y in float32."""
    angle = uniform_at(key, index) * np.float32(2 * math.pi)
    return np.float32(math.cos(angle)), np.float32(math.sin(angle))
