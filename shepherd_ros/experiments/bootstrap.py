"""Means with bootstrap intervals; episodes are resampled with the same seeds everywhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DRAWS = 2000
CONFIDENCE = 0.95


def resampled(episodes: int, draws: int = DRAWS, seed: int = 0) -> NDArray[np.int64]:
    """Return the indices of the episodes of each resample, (draws, episodes), by a fixed seed."""
    return np.random.default_rng(seed).integers(0, episodes, (draws, episodes))


def resampled_means(values: Array, draws: int = DRAWS) -> Array:
    """Return the means of each resample of the episodes (..., E), (..., draws)."""
    count = values.shape[-1]
    weight = np.zeros((draws, count))
    np.add.at(weight, (np.arange(draws)[:, None], resampled(count, draws)), 1 / count)
    return values @ weight.T


def percentiles(resampled_values: Array, confidence: float = CONFIDENCE) -> tuple[Array, Array]:
    """Return the ends of the interval of a quantity (..., draws), (...) each."""
    tail = 100 * (1 - confidence) / 2
    low, high = np.percentile(resampled_values, [tail, 100 - tail], axis=-1)
    return low, high


def mean_interval(values: Array) -> tuple[Array, Array, Array]:
    """Return mean, low and high end of the 95 % interval of (..., E); NaN ends for E = 1."""
    mean = values.mean(axis=-1)
    if values.shape[-1] < 2:
        return mean, np.full_like(mean, np.nan), np.full_like(mean, np.nan)
    low, high = percentiles(resampled_means(values))
    return mean, low, high
