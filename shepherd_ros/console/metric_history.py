"""Metrics of the running episode so far, for pages that open in its midst."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

MOST_POINTS = 2000  # of each curve


class Curves:
    """Values by step, every so many steps as an episode grows longer."""

    def __init__(self) -> None:
        """Begin with no point."""
        self.clear()

    def clear(self) -> None:
        """Begin anew."""
        self.steps: list[int] = []
        self.rows: list[dict[str, float]] = []
        self.apart = 1  # steps between two points at least

    def add(self, step: int, values: Mapping[str, float]) -> None:
        """Add the values of a step that is not too near to the last point."""
        if self.steps and step < self.steps[-1]:
            self.clear()
        if self.steps and step < self.steps[-1] + self.apart:
            return
        self.steps.append(step)
        self.rows.append(dict(values))
        if len(self.steps) > MOST_POINTS:
            self.steps, self.rows = self.steps[::2], self.rows[::2]
            self.apart *= 2

    def content(self) -> dict[str, Any]:
        """Return the fields of message `curves`."""
        names = sorted({name for row in self.rows for name in row})
        return {
            'steps': self.steps,
            'values': {name: [row.get(name) for row in self.rows] for name in names},
        }
