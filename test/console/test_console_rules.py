"""The console without a graph: access, commands, sessions, drives, curves, bags."""

from __future__ import annotations

import asyncio
from itertools import pairwise
import json
from pathlib import Path
import re
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.console.access import make_access
from shepherd_ros.console.commands import COMMAND_KINDS, CommandError, parse_command
from shepherd_ros.console.drives import DEAD_MAN, Drives, GIVE_BACK_AFTER
from shepherd_ros.console.frame_pace import FramePace
from shepherd_ros.console.job_values import map_states
from shepherd_ros.console.jobs import bag_path
from shepherd_ros.console.metric_history import Curves, MOST_POINTS
from shepherd_ros.console.sessions import MOST_TEXTS, Session
from shepherd_ros.console.state_frames import NUMBER_OFFSET

# --- access -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ('host', 'origin', 'ok'),
    [
        ('127.0.0.1:8080', None, True),
        ('localhost:9000', 'http://localhost:9000', True),  # through a tunnel
        ('[::1]:8080', 'http://[::1]:8080', True),
        ('LOCALHOST:8080', 'http://localhost:8080', True),
        ('evil.example:8080', None, False),
        ('evil.example:8080', 'http://evil.example:8080', False),
        ('localhost.evil.example', None, False),
        ('192.168.1.5:8080', None, False),
        ('127.0.0.1:8080', 'http://evil.example', False),
        ('127.0.0.1:8080', 'http://127.0.0.1:3000', False),
        ('127.0.0.1:8080', 'null', False),
        ('127.0.0.1:8080', 'file://', False),
        ('127.0.0.1:8080', 'http://[', False),
        ('', None, False),
        ('[', None, False),
    ],
)
def test_only_this_machine_and_its_own_page_may_ask(
    host: str, origin: str | None, ok: bool
) -> None:
    refusal = make_access('127.0.0.1', '', ['']).refusal(host, origin, '')
    assert (refusal == '') is ok
    if not ok:
        assert 'expected' in refusal


def test_other_machines_need_the_token_and_an_address_or_a_known_name() -> None:
    access = make_access('0.0.0.0', '', ['lab.example'])
    assert len(access.token) >= 32
    assert access.token != make_access('0.0.0.0', '', ['']).token
    for host in ('192.168.1.5:8080', 'lab.example:8080', 'localhost:8080'):
        assert access.refusal(host, None, access.token) == ''
        assert 'token' in access.refusal(host, None, '')
        assert 'token' in access.refusal(host, None, access.token[:-1] + '\u00e4')
    assert 'Host' in access.refusal('evil.example:8080', None, access.token)
    named = make_access('127.0.0.1', 'a' * 16, [''])
    assert named.refusal('localhost', None, 'a' * 16) == ''
    assert 'token' in named.refusal('localhost', None, '')
    for host, token in (('', ''), ('0.0.0.0', 'short')):
        with pytest.raises(ConfigError, match='expected'):
            make_access(host, token, [''])


# --- commands -----------------------------------------------------------------------------------


def test_every_command_is_read_from_an_example_of_each_field() -> None:
    for name, kind in COMMAND_KINDS.items():
        values = {key: about.example for key, about in kind.fields.items()}
        command = parse_command(json.dumps({'do': name, 'id': 5, **values}))
        assert (command.name, command.values, command.number) == (name, values, 5)
        assert kind.doc
        for key, about in kind.fields.items():
            lacking = {k: v for k, v in values.items() if k != key}
            text = json.dumps({'do': name, **lacking})
            if about.optional:
                assert parse_command(text).values == lacking
            else:
                with pytest.raises(CommandError, match=f'lacks {key}'):
                    parse_command(text)


@given(st.one_of(st.text(), st.binary(), st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(
        st.sampled_from(['do', 'id', 'x', 'steps', 'values', 'shepherd']), inner, max_size=4),
).map(json.dumps)))  # fmt: skip
def test_garbage_is_answered_in_words(text: str | bytes) -> None:
    try:
        command = parse_command(text)
    except CommandError as error:
        assert re.search('expected|lacks', str(error))
        assert len(str(error)) < 2000
    else:
        assert command.name in COMMAND_KINDS


def test_deep_nesting_and_numbers_that_are_none_are_refused() -> None:
    for text in (
        '[' * 60_000,
        '{"do": "goal", "x": NaN, "y": 0}',
        '{"do": "rate", "rate": 1e999}',
    ):
        with pytest.raises(CommandError):
            parse_command(text)


# --- sessions -----------------------------------------------------------------------------------


def frame(number: int) -> bytes:
    """Return what a session takes for a frame: its number is written into it."""
    return bytes(8) + number.to_bytes(4, 'little')


class Slow:
    """A page that takes a message when it is let."""

    def __init__(self) -> None:
        """Begin a session."""
        self.got: list[Any] = []
        self.may = asyncio.Semaphore(0)
        self.session = Session(self.write)

    async def write(self, content: str | bytes) -> None:
        """Take a message."""
        await self.may.acquire()
        self.got.append(content)

    async def read(self, count: int) -> list[Any]:
        """Let it take so many messages, and return those."""
        for _ in range(count):
            self.may.release()
        for _ in range(20):
            await asyncio.sleep(0)
        result, self.got = self.got, []
        return result


def test_a_slow_page_gets_the_newest_of_each_kind_once() -> None:
    async def play() -> None:
        page = Slow()
        pump = asyncio.create_task(page.session.pump())
        for k in range(1000):
            page.session.tell('metrics', f'm{k}')
            page.session.tell('episode', f'e{k}')
            page.session.show(frame(k))
        assert await page.read(3) == [
            'm999',
            'e999',
            frame(999)[:4] + b'\1\0\0\0' + frame(999)[8:],
        ]
        assert await page.read(3) == []
        pump.cancel()

    asyncio.run(play())


def test_at_most_two_frames_are_not_drawn() -> None:
    async def play() -> None:
        page = Slow()
        pump = asyncio.create_task(page.session.pump())

        async def numbers(shown: int) -> list[int]:
            page.session.show(frame(shown))
            return [raw[NUMBER_OFFSET] for raw in await page.read(1)]

        assert [await numbers(k) for k in range(4)] == [[1], [2], [], []]
        page.session.acknowledge(1)
        assert [raw[NUMBER_OFFSET:] for raw in await page.read(1)] == [
            b'\3\0\0\0' + frame(3)[8:]
        ]  # the newest of those that waited
        page.session.acknowledge(10**9)  # of frames that were never sent
        assert page.session.drawn == 3
        pump.cancel()

    asyncio.run(play())


def test_a_page_that_asks_and_does_not_read_is_closed() -> None:
    async def play() -> None:
        page = Slow()
        pump = asyncio.create_task(page.session.pump())
        for k in range(MOST_TEXTS + 2):
            page.session.answer(id=k, ok=True, text='')
        assert page.session.overrun
        await page.read(MOST_TEXTS + 2)
        assert pump.done()

    asyncio.run(play())


# --- drives -------------------------------------------------------------------------------------


class Team:
    """What drives do to shepherds, in order."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self.log: list[tuple[Any, ...]] = []
        self.drives = Drives(
            lambda h: self.log.append(('take', h)),
            lambda h, x, y, frame: self.log.append(('move', h, x, y)),
            lambda h: self.log.append(('give', h)),
        )


def test_one_page_drives_a_shepherd_until_it_is_silent() -> None:
    team = Team()
    assert team.drives.drive(1, 0, 0.5, 0.0, 'world', 10.0)
    assert not team.drives.drive(1, 0, 0.6, 0.0, 'world', 10.1)
    with pytest.raises(ConfigError, match='driven from page 1'):
        team.drives.drive(2, 0, 0.0, 0.0, 'world', 10.1)
    assert not team.drives.expire(10.09 + DEAD_MAN)
    assert team.log[-1] == ('move', 0, 0.6, 0.0)
    for wait in (0.01, 0.02, 0.03):  # it stops once, and the page has it still
        assert not team.drives.expire(10.1 + DEAD_MAN + wait)
    assert team.log[2:] == [('move', 0, 0.6, 0.0), ('move', 0, 0.0, 0.0)]
    assert not team.drives.drive(1, 0, 0.7, 0.0, 'world', 10.3)  # and goes on
    assert not team.drives.expire(10.29 + GIVE_BACK_AFTER)
    assert team.drives.expire(10.31 + GIVE_BACK_AFTER)
    assert team.log[4:] == [
        ('move', 0, 0.7, 0.0), ('move', 0, 0.0, 0.0), ('move', 0, 0.0, 0.0), ('give', 0)
    ]  # fmt: skip
    assert team.drives.drive(2, 0, 0.0, 0.0, 'world', 11.0)


def test_a_silent_page_stops_its_shepherd_in_time() -> None:
    """Half of 0.2 s is left for the way of zero to the shepherd."""
    assert DEAD_MAN <= 0.1 < GIVE_BACK_AFTER


@given(st.lists(st.tuples(
    st.sampled_from(['drive', 'release', 'close', 'expire', 'drop']), st.integers(1, 3),
    st.integers(0, 2), st.floats(0.0, 0.5),
), max_size=40))  # fmt: skip
def test_a_shepherd_is_held_by_one_and_stands_when_it_is_given_back(
    events: list[tuple[str, int, int, float]],
) -> None:
    team, now = Team(), 0.0
    for event, page, shepherd, wait in events:
        now += wait
        if event == 'drive':
            try:
                team.drives.drive(page, shepherd, 1.0, 1.0, 'world', now)
            except ConfigError:
                assert team.drives.holds[shepherd].page != page
        elif event == 'release':
            team.drives.release(page, shepherd)
        elif event == 'close':
            team.drives.release(page)
            assert page not in {hold.page for hold in team.drives.holds.values()}
        elif event == 'drop':
            team.drives.drop(shepherd)
        else:
            team.drives.expire(now)
            for h, hold in team.drives.holds.items():
                assert now - hold.last_command <= GIVE_BACK_AFTER
                last = [entry for entry in team.log if entry[:2] == ('move', h)][-1]
                assert (last[2:] == (0.0, 0.0)) == (now - hold.last_command > DEAD_MAN)
    team.drives.drop(None)
    for h in range(3):
        own = [entry for entry in team.log if entry[1] == h]
        held = False
        for before, entry in zip([(), *own], own, strict=False):
            if entry[0] == 'take':
                assert not held
                held = True
            elif entry[0] == 'give':
                assert held
                assert before == ('move', h, 0.0, 0.0)
                held = False
        assert not held


# --- value map -----------------------------------------------------------------------------------


def test_a_critic_that_has_learned_nothing_is_not_shown() -> None:
    for name in ('imitation', 'general'):
        with pytest.raises(ConfigError, match=f'{name}.*expected a policy that PPO has trained'):
            map_states({'checkpoint': name, 'shepherd': 0}, lambda **line: None)


# --- curves and bags ----------------------------------------------------------------------------


def test_frames_are_fewer_while_less_than_half_a_processor_is_spare() -> None:
    looks = iter([100.0, 100.45, 101.2, 102.2])  # spare time [s]
    pace = FramePace(60.0, 20.0, lambda: next(looks))
    seen = [1 / pace.period(now) for now in (0.0, 0.4, 1.0, 1.49, 2.0, 3.0)]
    # spare processors: not known, the same, 0.45, the same, 0.75, 1.0
    assert seen == pytest.approx([60, 60, 20, 20, 20, 60])
    assert 1 / FramePace(10.0, 20.0, lambda: 0.0).period(0.0) == pytest.approx(10)


def test_curves_of_a_long_episode_stay_short_and_even() -> None:
    curves = Curves()
    for step in range(20_000):
        curves.add(step, {'spread': float(step), **({'late': 1.0} if step > 9000 else {})})
    content = curves.content()
    steps = content['steps']
    assert MOST_POINTS / 2 <= len(steps) <= MOST_POINTS
    assert len({b - a for a, b in pairwise(steps)}) == 1
    assert content['values']['spread'] == [float(step) for step in steps]
    assert content['values']['late'][0] is None
    curves.add(3, {'spread': 1.0})  # of an episode that began anew
    assert curves.content()['steps'] == [3]


def test_a_page_reaches_no_path_outside_the_folder_of_bags(tmp_path: Path) -> None:
    folder = tmp_path / 'bags'
    folder.mkdir()
    (folder / 'good').mkdir()
    (tmp_path / 'secret').mkdir()
    (folder / 'link').symlink_to(tmp_path / 'secret')
    assert bag_path(folder, 'good') == folder / 'good'
    for name in ('', '.', '..', '../secret', 'good/../../secret', 'link', 'none', '/etc', 'a\0b'):
        with pytest.raises(ConfigError, match='expected the name of one in'):
            bag_path(folder, name)
