"""The law of mux: exactly one source, or zero, for each shepherd and stamp."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.nodes.body_frame import BodyFrames
from shepherd_ros.nodes.command_mux import (
    AUTO,
    check_priorities,
    Choice,
    CommandMux,
    CommandSource,
    Lock,
    ZERO,
)

POLICY = CommandSource('policy', 10, 3.0, answers=True)
OTHER = CommandSource('strombom', 9, 1.0, answers=True)
KEYS = CommandSource('keys', 90, 0.5)
JOY = CommandSource('joy', 100, 0.5)
SOURCES = (POLICY, OTHER, KEYS, JOY)
STOP = Lock('stop', 95, 0.0)
ALIVE = Lock('alive', 20, 1.0)
SPEED = (1.0, 2.0, 0.0)


def begun(*locks: Lock, lockstep: bool = True, team: int = 1) -> CommandMux:
    """Return a mux with a first state at 0 s."""
    mux = CommandMux(SOURCES, locks, default='policy', start_timeout=60.0)
    mux.begin(team, lockstep, now=0.0)
    mux.show(0, now=0.0)
    return mux


def driver(mux: CommandMux, now: float, shepherd: int = 0) -> str | None:
    """Return who drives; AssertionError where a source is waited for."""
    choice = mux.choose(shepherd, now)
    assert choice is not None
    return choice.driver


# --- priorities ---------------------------------------------------------------------------------


def test_the_source_of_highest_priority_that_is_not_silent_drives() -> None:
    mux = begun()
    mux.receive('policy', 0, SPEED, 0, now=0.0)
    assert driver(mux, 0.1) == 'policy'
    mux.receive('keys', 0, SPEED, None, now=0.1)
    assert driver(mux, 0.6) == 'keys'
    mux.receive('joy', 0, ZERO, None, now=0.6)  # zero is a command, too
    mux.receive('keys', 0, SPEED, None, now=0.6)
    assert mux.choose(0, 0.6) == Choice('joy', ZERO, 0)
    mux.receive('keys', 0, SPEED, None, now=1.1)
    assert driver(mux, 1.2) == 'keys'  # joy is silent for 0.6 s
    assert driver(mux, 1.7) == 'policy'


@pytest.mark.parametrize(
    ('sources', 'locks', 'message'),
    [
        ((KEYS, replace(JOY, priority=90)), (), 'topics.joy.priority is 90, as that of keys'),
        ((KEYS, JOY), (Lock('stop', 90),), 'locks.stop.priority is 90: expected more than 90'),
        ((KEYS, JOY), (Lock('stop', 1),), 'locks.stop.priority is 1: expected more than 90'),
    ],
)
def test_a_priority_that_means_nothing_is_refused_by_name(
    sources: Sequence[CommandSource], locks: Sequence[Lock], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        check_priorities(sources, locks)
    with pytest.raises(ConfigError, match=message):
        CommandMux(sources, locks)
    check_priorities(SOURCES, (STOP, ALIVE))


# --- silence ------------------------------------------------------------------------------------


def test_a_source_that_answers_is_waited_for_up_to_its_timeout_and_once() -> None:
    mux = begun()
    mux.receive('policy', 0, SPEED, 0, now=0.0)
    mux.show(1, now=1.0)
    assert mux.choose(0, 1.0) is None
    assert mux.choose(0, 4.0) is None
    assert mux.choose(0, 4.01) == Choice(None, ZERO, 1)
    mux.show(2, now=4.1)
    assert mux.choose(0, 4.1) == Choice(None, ZERO, 2)  # it is known to be silent
    mux.receive('policy', 0, SPEED, 1, now=4.2)  # too late, but it is there again
    mux.show(3, now=4.3)
    assert mux.choose(0, 4.3) is None
    mux.receive('policy', 0, SPEED, 3, now=4.4)
    assert mux.choose(0, 4.4) == Choice('policy', SPEED, 3)
    assert mux.choose(0, 99.0) == Choice('policy', SPEED, 3)  # a paused world asks for no more


def test_the_default_source_may_take_long_to_start_and_others_are_not_waited_for() -> None:
    mux = begun()
    assert mux.choose(0, 59.0) is None
    assert driver(mux, 60.1) is None
    mux = begun()
    mux.receive('strombom', 0, SPEED, 0, now=0.5)
    assert mux.choose(0, 1.0) is None  # the default has a higher priority
    mux.receive('policy', 0, SPEED, 0, now=2.0)
    assert driver(mux, 2.0) == 'policy'


def test_an_answer_that_comes_before_its_state_counts_when_that_comes() -> None:
    mux = begun()
    mux.receive('policy', 0, SPEED, 0, now=0.0)
    mux.receive('policy', 0, SPEED, 500, now=0.1)
    mux.show(500, now=0.2)
    assert mux.choose(0, 0.2) == Choice('policy', SPEED, 500)


def test_a_source_that_stands_by_takes_over_from_one_that_is_silent() -> None:
    mux = begun()
    for name in ('policy', 'strombom'):
        mux.receive(name, 0, SPEED, 0, now=0.0)
    mux.show(1, now=1.0)
    mux.receive('strombom', 0, SPEED, 1, now=1.1)
    assert mux.choose(0, 3.9) is None
    assert driver(mux, 4.1) == 'strombom'


def test_what_is_selected_and_silent_gives_zero_at_once() -> None:
    mux = begun()
    mux.receive('policy', 0, SPEED, 0, now=0.0)
    mux.select('keys', None, now=0.1)
    assert mux.choose(0, 0.1) == Choice(None, ZERO, 0)
    mux.receive('keys', 0, SPEED, None, now=0.2)
    assert driver(mux, 0.7) == 'keys'
    assert mux.choose(0, 0.71) == Choice(None, ZERO, 0)
    mux.receive('joy', 0, SPEED, None, now=0.8)
    assert driver(mux, 0.8) is None  # priorities do not count
    mux.select(AUTO, 0, now=0.8)
    assert driver(mux, 0.8) == 'joy'


def test_in_realtime_nothing_is_waited_for() -> None:
    mux = begun(lockstep=False)
    assert driver(mux, 0.0) is None
    mux.receive('policy', 0, SPEED, 0, now=0.1)
    mux.show(1, now=0.5)
    assert mux.choose(0, 0.6) == Choice('policy', SPEED, 0)
    assert driver(mux, 3.2) is None


# --- locks --------------------------------------------------------------------------------------


def test_a_lock_stops_the_sources_of_lower_priority() -> None:
    mux = begun(STOP)
    mux.receive('policy', 0, SPEED, 0, now=0.0)
    mux.receive('keys', 0, SPEED, None, now=0.0)
    mux.receive_lock('stop', True, now=0.0)
    assert mux.choose(0, 0.1) == Choice(None, ZERO, 0)
    mux.receive('joy', 0, SPEED, None, now=0.1)
    assert driver(mux, 0.1) == 'joy'
    mux.select('keys', 0, now=0.1)
    assert driver(mux, 0.1) is None
    mux.receive_lock('stop', False, now=0.2)
    assert driver(mux, 0.2) == 'keys'


def test_a_lock_with_a_timeout_locks_before_it_is_heard_and_when_it_is_silent() -> None:
    mux = begun(ALIVE)
    mux.receive('policy', 0, SPEED, 0, now=0.0)
    assert driver(mux, 0.0) is None
    mux.receive_lock('alive', False, now=0.1)
    assert driver(mux, 1.0) == 'policy'
    assert driver(mux, 1.2) is None


def test_a_shepherd_that_is_locked_by_hand_has_no_driver_whatever_its_sources_say() -> None:
    mux = begun(team=2)
    for h in range(2):
        mux.receive('joy', h, SPEED, None, now=0.0)
    mux.lock(True, 1)
    assert (driver(mux, 0.1, 0), driver(mux, 0.1, 1)) == ('joy', None)
    mux.lock(True)
    assert (driver(mux, 0.1, 0), driver(mux, 0.1, 1)) == (None, None)
    mux.lock(False)
    assert (driver(mux, 0.1, 0), driver(mux, 0.1, 1)) == ('joy', 'joy')


def test_a_source_or_a_shepherd_that_is_not_there_is_refused_by_name() -> None:
    mux = begun(team=2)
    with pytest.raises(ConfigError, match=r"source is 'kyes'.*did you mean 'keys'"):
        mux.select('kyes', 0, now=0.0)
    for act in (lambda: mux.select('keys', 2, now=0.0), lambda: mux.lock(True, -1)):
        with pytest.raises(ConfigError, match='expected one of the 2 of the episode'):
            act()


# --- any course of events -----------------------------------------------------------------------

TEAM = 2
NAMES = st.sampled_from([source.name for source in SOURCES])
WHO = st.sampled_from([None, *range(TEAM)])
EVENTS = st.one_of(
    st.tuples(st.just('wait'), st.floats(0.0, 2.0)),
    st.tuples(st.just('state')),
    st.tuples(st.just('hear'), NAMES, st.integers(0, TEAM - 1), st.integers(-1, 1)),
    st.tuples(st.just('select'), st.one_of(NAMES, st.just(AUTO)), WHO),
    st.tuples(st.just('lock'), st.booleans(), WHO),
    st.tuples(st.just('hear_lock'), st.sampled_from(['stop', 'alive']), st.booleans()),
)


class Told:
    """What a mux was told, kept in the plainest way, and what follows from the words of it."""

    def __init__(self, lockstep: bool) -> None:
        """Begin with the first state."""
        self.lockstep, self.now, self.stamp, self.shown = lockstep, 0.0, 0, 0.0
        self.received: dict[tuple[str, int], tuple[float, int, float]] = {}  # when, stamp, speed
        self.selected = [AUTO] * TEAM
        self.locked = [False] * TEAM
        self.locks: dict[str, tuple[float, bool]] = {}
        self.n = 0

    def masked(self, source: CommandSource) -> bool:
        """Return whether a lock stops a source."""
        for lock in (STOP, ALIVE):
            when, on = self.locks.get(lock.name, (-math.inf, False))
            late = lock.timeout > 0 and self.now - when > lock.timeout
            if (on or late) and source.priority < lock.priority:
                return True
        return False

    def ready(self, source: CommandSource, h: int) -> bool:
        """Return whether a source has a command for the present state."""
        when, stamp, _ = self.received.get((source.name, h), (-math.inf, -1, 0.0))
        if source.answers and self.lockstep:
            return stamp == self.stamp
        return self.now - when <= source.timeout

    def check(self, h: int, choice: Choice | None) -> None:
        """Assert that a choice is allowed."""
        may = [
            s
            for s in SOURCES
            if self.selected[h] in (AUTO, s.name) and not self.masked(s) and not self.locked[h]
        ]
        ready = sorted((s for s in may if self.ready(s, h)), key=lambda s: -s.priority)
        if choice is None:  # a source is waited for, whose command would have precedence
            waited = [s for s in may if s.answers and not self.ready(s, h)]
            assert self.lockstep
            assert waited
            assert not ready or ready[0].priority < max(s.priority for s in waited)
            longest = max(max(s.timeout, 60.0 if s == POLICY else 0) for s in waited)
            assert self.now - self.shown <= longest or self.selected[h] != AUTO
        elif choice.driver is None:
            assert not ready
            assert choice.velocity == ZERO
            assert choice.stamp_ns == self.stamp
        else:
            assert choice.driver == ready[0].name
            _, stamp, speed = self.received[choice.driver, h]
            assert choice.velocity == (speed, 0.0, 0.0)
            assert choice.stamp_ns == (stamp if ready[0].answers else self.stamp)


@settings(max_examples=300, deadline=None)
@given(st.booleans(), st.lists(EVENTS, max_size=40))
def test_one_source_or_zero_drives_each_shepherd_whatever_comes_goes_and_is_locked(
    lockstep: bool, events: list[tuple]
) -> None:
    mux, output = begun(STOP, ALIVE, lockstep=lockstep, team=TEAM), Told(lockstep)
    for name, *values in events:
        output.n += 1
        if name == 'wait':
            output.now += values[0]
        elif name == 'state':
            output.stamp, output.shown = output.stamp + 1, output.now
            assert mux.show(output.stamp, output.now)
        elif name == 'hear':
            source, h, off = values
            answers = source in ('policy', 'strombom')
            stamp = output.stamp + off if answers else None
            mux.receive(source, h, (float(output.n), 0.0, 0.0), stamp, output.now)
            output.received[source, h] = (
                output.now,
                output.stamp if stamp is None else stamp,
                output.n,
            )
        elif name == 'select':
            mux.select(*values, output.now)
            for h in mux.team(values[1]):
                output.selected[h] = values[0]
        elif name == 'lock':
            mux.lock(*values)
            for h in mux.team(values[1]):
                output.locked[h] = values[0]
        else:
            mux.receive_lock(*values, output.now)
            output.locks[values[0]] = output.now, values[1]
        assert not mux.show(
            output.stamp, output.now
        )  # a state that is shown again changes nothing
        for h in range(TEAM):
            choice = mux.choose(h, output.now)
            output.check(h, choice)
            assert mux.choose(h, output.now) == choice


@settings(max_examples=100, deadline=None)
@given(st.lists(EVENTS, max_size=30))
def test_no_state_is_waited_on_for_ever(events: list[tuple]) -> None:
    mux, now = begun(STOP, ALIVE, team=TEAM), 0.0
    act: dict[str, Callable[..., None]] = {
        'wait': lambda seconds: None,
        'state': lambda: None,
        'hear': lambda source, h, off: mux.receive(source, h, SPEED, mux.stamp_ns + off, now),
        'select': lambda source, h: mux.select(source, h, now),
        'lock': mux.lock,
        'hear_lock': lambda lock, on: mux.receive_lock(lock, on, now),
    }
    for name, *values in events:
        act[name](*values)
        now += values[0] if name == 'wait' else 0.0
        if name == 'state':
            mux.show(mux.stamp_ns + 1, now)
    end = now + 60.0 + sum(source.timeout for source in SOURCES)
    for h in range(TEAM):
        for _ in SOURCES:
            mux.choose(h, end)
        assert mux.choose(h, end) is not None


# --- the frame of the body ----------------------------------------------------------------------


def moved(frames: BodyFrames, *xy: float, turn: float | None = None, dt: float = 0.5) -> None:
    """Move one shepherd to a place [m]."""
    frames.move(np.array([xy]), np.zeros((1, 2)), [turn], dt)


def test_forward_is_where_a_shepherd_went_last() -> None:
    frames = BodyFrames()
    moved(frames, 0.0, 0.0)
    assert frames.to_world(0, (1.0, 0.0, 0.0)) == (1.0, 0.0)
    moved(frames, 0.0, 2.0)  # to the north
    assert frames.to_world(0, (1.0, 0.0, 0.0)) == pytest.approx((0.0, 1.0))
    assert frames.to_world(0, (0.0, 1.0, 0.0)) == pytest.approx((-1.0, 0.0))  # left is west
    moved(frames, 0.0, 2.0)  # it stands still, and looks where it looked
    assert frames.to_world(0, (1.0, 0.0, 0.0)) == pytest.approx((0.0, 1.0))


def test_a_shepherd_that_is_driven_backwards_does_not_turn_round() -> None:
    frames = BodyFrames()
    moved(frames, 0.0, 0.0)
    moved(frames, 0.0, 1.0)
    for _ in range(3):
        x, y = frames.to_world(0, (-1.0, 0.0, 0.0))
        assert (x, y) == pytest.approx((0.0, -1.0))
        moved(frames, *(frames.position[0] + (x, y)), turn=0.0)


def test_a_turn_is_a_rate_and_counter_clockwise() -> None:
    frames = BodyFrames()
    moved(frames, 0.0, 0.0)
    for _ in range(4):
        moved(frames, 0.0, 0.0, turn=math.pi / 4)  # rad/s for half a second each
    assert frames.yaw[0] == pytest.approx(math.pi / 2)
    for _ in range(8):
        moved(frames, 0.0, 0.0, turn=math.pi)
    assert math.cos(frames.yaw[0] - math.pi / 2) == pytest.approx(1.0)
