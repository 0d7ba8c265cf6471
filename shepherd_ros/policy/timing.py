"""A policy's times in the steps of an episode: when it decides, and which readings it sees."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from shepherd_ros.sim.frames import Frames, nearest_steps

TOLERANCE = 1e-6  # of a duration, within which it is kept


@dataclass(frozen=True)
class Timing:
    """
    Decisions and frames of a policy in episodes of one time step.

    A time that is no multiple of the step, or shorter, becomes the nearest whole number of steps.
    """

    asked_decision: float  # [s] from one decision to the next, as in training
    asked_frame: float  # [s] from one frame to the next, as in training
    n_frames: int
    dt: float  # [s] of the episode

    @cached_property
    def action_repeat(self) -> int:
        """Return the steps from one decision to the next, for which an action is held."""
        return nearest_steps(self.asked_decision, self.dt)

    @property
    def decision_interval(self) -> float:
        """Return the time from one decision to the next [s]."""
        return self.action_repeat * self.dt

    @cached_property
    def frames(self) -> Frames:
        """Return the frames of the observation, counted in decisions."""
        return Frames(self.n_frames, nearest_steps(self.asked_frame, self.decision_interval))

    @property
    def frame_interval(self) -> float:
        """Return the time from one frame to the next [s]."""
        return self.frames.spacing * self.decision_interval

    @property
    def deviation(self) -> str:
        """Return which times are used for those that cannot be kept, empty if all are kept."""
        pairs = [('decides every', self.decision_interval, self.asked_decision)]
        if self.n_frames > 1:
            pairs.append(('sees frames', self.frame_interval, self.asked_frame))
        changes = [
            f'{what} {used:.4g} s{" apart" * (what != "decides every")} instead of {wanted:.4g} s'
            for what, used, wanted in pairs
            if abs(used - wanted) > TOLERANCE * wanted
        ]
        return ', '.join(changes) + f', as a step takes {self.dt:g} s' if changes else ''
