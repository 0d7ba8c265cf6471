"""Pauses, single steps, the wait for readers before the first step, and the rate of steps."""

from __future__ import annotations

DISCOVERY_SETTLE_TIME = (
    0.2  # [s] wall time without a new reader after which the first step may be made
)
RATE_KEPT = 0.95  # share of the steps of a rate that have to be made
LACKING_DECAY = 0.9  # of steps behind from report to report
MAX_LACKING = 2.0  # steps behind that are no jitter of a timer


class Pacing:
    """State of the pause and of the first step of flock_sim."""

    def __init__(self, now: float) -> None:
        """Wait for readers from now on, in [s] of wall time."""
        self.paused = False
        self.steps_left = 0  # steps to make although paused
        self.limited = self.held = False  # whether each step waits for a timer, and this one does
        self.settled = False
        self.readers, self.reader_came = 0, now
        self.made, self.looked = 0, now  # steps since the rate was asked for, and when that was
        self.lacking = 0.0  # steps behind, older ones count less

    @property
    def resting(self) -> bool:
        """Return whether no step is coming until someone asks for one."""
        return self.paused and self.steps_left == 0

    def pause(self, paused: bool, steps: int = 0) -> None:
        """Pause after so many steps more, or go on."""
        self.paused, self.steps_left = paused, steps

    def may_move(self) -> bool:
        """Return whether a step may be made now, and count it if only some may."""
        if not self.settled or self.resting or self.held:
            return False
        self.held = self.limited
        self.steps_left = max(self.steps_left - 1, 0)
        self.made += 1
        return True

    def report(self, now: float, wanted: float) -> tuple[float, str]:
        """
        Return the steps per second since the last report, and what is to be said of them.

        wanted steps per second are due, 0 if none are.
        """
        seconds = max(now - self.looked, 1e-3)
        rate = self.made / seconds
        due = 0.0 if self.resting or not self.settled else RATE_KEPT * wanted * seconds
        self.lacking = max(0.0, LACKING_DECAY * self.lacking + due - self.made)
        self.made, self.looked = 0, now
        if self.paused:
            return rate, 'paused'
        slow = f'{rate:.4g} steps per second are made, expected {wanted:.4g}'
        return rate, slow if self.lacking > MAX_LACKING else ''

    def settle(self, readers: int, now: float) -> bool:
        """Return whether readers are new; settled once none came for a while: DDS finds slowly."""
        came = readers != self.readers
        if came:
            self.readers, self.reader_came = readers, now
        self.settled = not came and now - self.reader_came > DISCOVERY_SETTLE_TIME
        return came
