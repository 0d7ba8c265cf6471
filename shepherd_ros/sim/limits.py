"""Limits of worlds, the same for parameters, messages and files."""

from __future__ import annotations

MAX_SHEEP = 10_000
MAX_SHEPHERDS = 100
MAX_STEPS = 10_000_000  # of an episode
MIN_DT, MAX_DT = 0.001, 10.0  # [s]
MAX_SEED = 2**62  # episodes count up from there in 64 bits
MAX_FLOAT32 = (2 - 2**-23) * 2.0**127
