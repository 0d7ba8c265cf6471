"""Mean, deviation and limits of numbers that come in parts."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


class RunningStats:
    """Mean, deviation and limits of each column of rows; only finite numbers count."""

    def __init__(self, columns: int) -> None:
        """Begin with nothing."""
        self.count = np.zeros(columns, np.int64)
        self._sum, self._squares = np.zeros(columns), np.zeros(columns)
        self._low, self._high = np.full(columns, np.inf), np.full(columns, -np.inf)

    def add(self, values: ArrayLike) -> None:
        """Take rows (n, columns)."""
        rows = np.asarray(values, np.float64)
        there = np.isfinite(rows)
        self.count += there.sum(axis=0)
        kept = np.where(there, rows, 0.0)
        self._sum += kept.sum(axis=0)
        self._squares += np.square(kept).sum(axis=0)
        low, high = np.where(there, rows, np.inf), np.where(there, rows, -np.inf)
        self._low = np.minimum(self._low, low.min(axis=0, initial=np.inf))
        self._high = np.maximum(self._high, high.max(axis=0, initial=-np.inf))

    def to_dict(self) -> dict[str, list[float]]:
        """Return mean, std, min and max of each column; zeros where nothing came."""
        some = np.maximum(self.count, 1)
        mean = self._sum / some
        std = np.sqrt(np.maximum(self._squares / some - mean**2, 0.0))
        low, high = (np.where(self.count > 0, x, 0.0) for x in (self._low, self._high))
        rows = {'mean': mean, 'std': std, 'min': low, 'max': high}
        return {name: values.tolist() for name, values in rows.items()}
