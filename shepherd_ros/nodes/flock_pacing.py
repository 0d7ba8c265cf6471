"""Pauses, single steps and the wait for readers before the first step."""

from __future__ import annotations

DISCOVERY_SETTLE_TIME = (
    0.2  # [s] wall time without a new reader after which the first step may be made
)


class Pacing:
    """Whether flock_sim may move its world."""

    def __init__(self, now: float) -> None:
        """Wait for readers from now on, in [s] of wall time."""
        self.paused = False
        self.steps_left = 0  # steps to make although paused
        self.settled = False
        self.readers, self.reader_came = 0, now

    @property
    def resting(self) -> bool:
        """Return whether no step is coming until someone asks for one."""
        return self.paused and self.steps_left == 0

    def pause(self, paused: bool, steps: int = 0) -> None:
        """Pause after so many steps more, or go on."""
        self.paused, self.steps_left = paused, steps

    def may_move(self) -> bool:
        """Return whether a step may be made now, and count it if only some may."""
        if not self.settled or self.resting:
            return False
        self.steps_left = max(self.steps_left - 1, 0)
        return True

    def settle(self, readers: int, now: float) -> bool:
        """Return whether readers are new; settled once none came for a while: DDS finds slowly."""
        came = readers != self.readers
        if came:
            self.readers, self.reader_came = readers, now
        self.settled = not came and now - self.reader_came > DISCOVERY_SETTLE_TIME
        return came
