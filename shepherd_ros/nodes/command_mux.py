"""The law of mux: the source that drives each shepherd at a stamp (no rclpy, no torch)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
import math
from typing import NamedTuple

from shepherd_ros.config import ConfigError, unknown_name

AUTO = 'auto'  # selects by priority

Velocity = tuple[float, float, float]  # x, y [m/s], turn [rad/s]
ZERO: Velocity = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class CommandSource:
    """Commands of one kind: a topic for each shepherd."""

    name: str
    priority: int  # the higher one drives
    timeout: float  # [s] without a command after which it is silent
    answers: bool = False  # to each state with its stamp; else its last command holds


@dataclass(frozen=True)
class Lock:
    """A topic that locks the sources of lower priority while it says true or is silent."""

    name: str
    priority: int
    timeout: float = 0.0  # [s] without a message after which it locks; 0: never


class Choice(NamedTuple):
    """A command for one shepherd, and the source that it is from, None for zero."""

    driver: str | None
    velocity: Velocity
    stamp_ns: int  # of the state that it answers


@dataclass
class _SourceState:
    """Last command of one source for one shepherd."""

    since: float  # [s] when it may have begun
    silent: bool  # it is not waited for until it is heard again
    velocity: Velocity = ZERO
    stamp_ns: int = -1
    received: float = -math.inf  # [s] when the last command came


def check_priorities(sources: Sequence[CommandSource], locks: Sequence[Lock]) -> None:
    """Raise ConfigError where priorities do not say which source drives, or lock none."""
    by_priority: dict[int, str] = {}
    for source in sources:
        other = by_priority.setdefault(source.priority, source.name)
        if other != source.name:
            raise ConfigError(
                f'topics.{source.name}.priority is {source.priority}, as that of {other}: '
                'expected a priority of its own, as the source with the higher one drives'
            )
    lowest = min(source.priority for source in sources)
    for lock in locks:
        if lock.priority <= lowest:
            raise ConfigError(
                f'locks.{lock.name}.priority is {lock.priority}: expected more than {lowest}, the '
                'lowest of the sources, as a lock stops those of lower priority'
            )


@dataclass
class CommandMux:
    """
    Selects one source, or zero, for each shepherd and stamp.

    A source that answers is waited for up to its timeout, and the default one at the start for
    start_timeout; one that was silent is waited for again once it is heard. Times are in [s] of
    one clock.
    """

    sources: Sequence[CommandSource]
    locks: Sequence[Lock] = ()
    default: str = ''  # a source to wait for at the start
    start_timeout: float = 60.0  # [s]
    lockstep: bool = field(default=True, init=False)
    n_shepherds: int = field(default=0, init=False)
    stamp_ns: int = field(default=-1, init=False)  # of the present state
    shown: float = field(default=-math.inf, init=False)  # [s] when that was heard first
    selected: list[str] = field(default_factory=list, init=False)  # a name or AUTO, by shepherd
    locked: list[bool] = field(default_factory=list, init=False)  # by hand, by shepherd

    def __post_init__(self) -> None:
        """Refuse priorities that mean nothing; begin() makes ready."""
        check_priorities(self.sources, self.locks)
        self.by_name = {source.name: source for source in self.sources}
        self.order = sorted(self.sources, key=lambda source: -source.priority)
        self.states: list[dict[str, _SourceState]] = []  # by shepherd
        self.lock_received: dict[str, tuple[bool, float]] = {}

    def begin(self, n_shepherds: int, lockstep: bool, now: float) -> None:
        """Make ready for an episode; what was selected and locked stays."""
        self.lockstep, self.n_shepherds = lockstep, n_shepherds
        for _ in range(len(self.states), n_shepherds):
            self.states.append(
                {name: _SourceState(now, silent=name != self.default) for name in self.by_name}
            )
            self.selected.append(AUTO)
            self.locked.append(False)

    def show(self, stamp_ns: int, now: float) -> bool:
        """Turn to the present state; return whether it is another one than before."""
        if stamp_ns == self.stamp_ns:
            return False
        self.stamp_ns, self.shown = stamp_ns, now
        return True

    def receive(
        self, name: str, shepherd: int, velocity: Velocity, stamp_ns: int | None, now: float
    ) -> None:
        """Take a command of a source; without a stamp it answers the present state."""
        state = self.states[shepherd][name]
        state.velocity, state.received, state.silent = velocity, now, False
        state.stamp_ns = self.stamp_ns if stamp_ns is None else stamp_ns

    def receive_lock(self, name: str, on: bool, now: float) -> None:
        """Take a message of a lock."""
        self.lock_received[name] = on, now

    def select(self, name: str, shepherd: int | None, now: float) -> None:
        """Let a source drive one shepherd or all; AUTO: the one of highest priority."""
        if name != AUTO and name not in self.by_name:
            raise unknown_name('source', name, [AUTO, *self.by_name])
        for h in self.team(shepherd):
            self.selected[h] = name
            if name != AUTO:
                state = self.states[h][name]
                state.since, state.silent = max(state.since, now), False

    def lock(self, on: bool, shepherd: int | None = None) -> None:
        """Lock one shepherd or all, or let them go."""
        for h in self.team(shepherd):
            self.locked[h] = on

    def team(self, shepherd: int | None) -> range:
        """Return one shepherd or all of the episode; raises ConfigError for one of no episode."""
        if shepherd is None:
            return range(self.n_shepherds)
        if not 0 <= shepherd < self.n_shepherds:
            raise ConfigError(
                f'shepherd is {shepherd}: expected one of the {self.n_shepherds} of the episode, '
                'counted from 0'
            )
        return range(shepherd, shepherd + 1)

    def floor(self, now: float) -> int:
        """Return the priority that a source needs to drive, as locks have it."""
        floor = 0
        for lock in self.locks:
            on, received = self.lock_received.get(lock.name, (False, -math.inf))
            if on or 0 < lock.timeout < now - received:
                floor = max(floor, lock.priority)
        return floor

    def choose(self, shepherd: int, now: float) -> Choice | None:
        """Return the command of a shepherd for the present state, None to wait for a source."""
        zero = Choice(None, ZERO, self.stamp_ns)
        if self.locked[shepherd]:
            return zero
        floor, states, name = self.floor(now), self.states[shepherd], self.selected[shepherd]
        for source in self.order if name == AUTO else [self.by_name[name]]:
            if source.priority < floor:
                continue
            state = states[source.name]
            if source.answers and self.lockstep:
                if state.stamp_ns == self.stamp_ns:
                    return Choice(source.name, state.velocity, self.stamp_ns)
                if self._awaited(source, state, now):
                    return None
            elif now - state.received <= source.timeout:
                stamp_ns = state.stamp_ns if source.answers else self.stamp_ns
                return Choice(source.name, state.velocity, stamp_ns)
        return zero

    def _awaited(self, source: CommandSource, state: _SourceState, now: float) -> bool:
        """Return whether an answer to the present state may still come in time."""
        starting = source.name == self.default and state.received == -math.inf
        timeout = max(self.start_timeout, source.timeout) if starting else source.timeout
        since = state.since if starting else max(self.shown, state.since)
        state.silent = state.silent or now - since > timeout
        return not state.silent
