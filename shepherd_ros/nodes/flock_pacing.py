"""Pauses, single steps, the wait for readers before the first step, and the rate of steps."""

from __future__ import annotations

DISCOVERY_SETTLE_TIME = (
    0.2  # [s] wall time without a new reader after which the first step may be made
)
MIN_RATE_FRACTION = 0.95  # of the steps of a rate, which have to be made
BEHIND_DECAY = 0.9  # of steps behind, from report to report
MAX_STEPS_BEHIND = 2.0  # steps behind that are no jitter of a timer


class Pacing:
    """State of the pause and of the first step of flock_sim."""

    def __init__(self, now: float) -> None:
        """Wait for readers from now on, in [s] of wall time."""
        self.paused = False
        self.steps_left = 0  # steps to make although paused
        self.limited = self.held = False  # whether each step waits for a timer, and this one does
        self.settled = False
        self.readers, self.last_reader_time = 0, now
        self.steps_made, self.last_report_time = 0, now  # since the last report
        self.steps_behind = 0.0  # steps behind, older ones count less

    @property
    def resting(self) -> bool:
        """Return whether the world is paused and no requested step is left."""
        return self.paused and self.steps_left == 0

    def pause(self, paused: bool, steps: int = 0) -> None:
        """Pause after some more steps, or go on."""
        self.paused, self.steps_left = paused, steps

    def may_move(self) -> bool:
        """Return whether a step may be made now, and count it if only some may."""
        if not self.settled or self.resting or self.held:
            return False
        self.held = self.limited
        self.steps_left = max(self.steps_left - 1, 0)
        self.steps_made += 1
        return True

    def report(self, now: float, expected: float) -> tuple[float, str]:
        """
        Return the steps per second since the last report, and a warning, '' if all is well.

        expected is the rate in steps per second, 0 without one.
        """
        seconds = max(now - self.last_report_time, 1e-3)
        rate = self.steps_made / seconds
        due = 0.0 if self.resting or not self.settled else MIN_RATE_FRACTION * expected * seconds
        self.steps_behind = max(0.0, BEHIND_DECAY * self.steps_behind + due - self.steps_made)
        self.steps_made, self.last_report_time = 0, now
        if self.paused:
            return rate, 'paused'
        fault = f'{rate:.4g} steps per second are made, expected {expected:.4g}'
        return rate, fault if self.steps_behind > MAX_STEPS_BEHIND else ''

    def settle(self, readers: int, now: float) -> bool:
        """Return whether the number of readers changed; settled once it is stable for a while."""
        changed = readers != self.readers
        if changed:
            self.readers, self.last_reader_time = readers, now
        self.settled = not changed and now - self.last_reader_time > DISCOVERY_SETTLE_TIME
        return changed
