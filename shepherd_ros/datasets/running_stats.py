"""Mean, deviation and limits of numbers that come in parts."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


class RunningStats:
    """Mean, deviation and limits of each column of rows; only finite numbers count."""

    def __init__(self, columns: int) -> None:
        """Start without values."""
        self.count = np.zeros(columns, np.int64)
        self._sum, self._squares = np.zeros(columns), np.zeros(columns)
        self._low, self._high = np.full(columns, np.inf), np.full(columns, -np.inf)

    def add(self, values: ArrayLike) -> None:
        """Add rows (n, columns)."""
        rows = np.asarray(values, np.float64)
        finite = np.isfinite(rows)
        self.count += finite.sum(axis=0)
        values_or_zero = np.where(finite, rows, 0.0)
        self._sum += values_or_zero.sum(axis=0)
        self._squares += np.square(values_or_zero).sum(axis=0)
        low, high = np.where(finite, rows, np.inf), np.where(finite, rows, -np.inf)
        self._low = np.minimum(self._low, low.min(axis=0, initial=np.inf))
        self._high = np.maximum(self._high, high.max(axis=0, initial=-np.inf))

    def to_dict(self) -> dict[str, list[float]]:
        """Return mean, std, min and max of each column; zeros for a column without values."""
        count = np.maximum(self.count, 1)
        mean = self._sum / count
        std = np.sqrt(np.maximum(self._squares / count - mean**2, 0.0))
        low, high = (np.where(self.count > 0, x, 0.0) for x in (self._low, self._high))
        rows = {'mean': mean, 'std': std, 'min': low, 'max': high}
        return {name: values.tolist() for name, values in rows.items()}
