"""Pace of the frames of the console: fewer while the processors have hardly any time to spare."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path

LOOK_PERIOD = 0.5  # [s] between two looks at the processors
BUSY_BELOW = 0.5  # spare processors under which frames are fewer
FREE_ABOVE = 1.0  # spare processors from which on they are as many as before
_TICKS = os.sysconf('SC_CLK_TCK')
_STAT = Path('/proc/stat')
_NICE, _IDLE, _IOWAIT = 1, 3, 4  # columns of the line cpu


def spare_time() -> float:
    """Return the time of all processors so far that was idle, or of niced processes [s]."""
    line = _STAT.read_text(encoding='ascii').partition('\n')[0].split()[1:]
    return sum(int(line[column]) for column in (_NICE, _IDLE, _IOWAIT)) / _TICKS


class FramePace:
    """
    Frames per second: `free` of them, and `busy` of them while pages compete with the graph.

    Pages compete with it when less than half a processor is spare; processes with a nice value
    give way, so that what they use counts as spare.
    """

    def __init__(self, free: float, busy: float, spare: Callable[[], float] = spare_time) -> None:
        """Begin with all; spare() returns the spare time of all processors so far [s]."""
        self.free, self.busy, self._spare = free, min(busy, free), spare
        self.competes = False
        self._last: tuple[float, float] | None = None  # time [s] and spare time [s]

    def period(self, now: float) -> float:
        """Return the time between two frames [s]; now is a monotonic time [s]."""
        if self._last is None or now - self._last[0] >= LOOK_PERIOD:
            self._look(now)
        return 1 / (self.busy if self.competes else self.free)

    def _look(self, now: float) -> None:
        """Find out how many processors were spare since the last look."""
        spare = self._spare()
        if self._last is not None:
            processors = (spare - self._last[1]) / (now - self._last[0])
            self.competes = processors < (FREE_ABOVE if self.competes else BUSY_BELOW)
        self._last = now, spare
