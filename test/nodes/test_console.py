"""The console against a running graph, with tornado's client as its page."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
import json
from pathlib import Path
import re
import sys
import time
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

from console.pages_of_tests import ANSWER, TestPage
from geometry_msgs.msg import PoseStamped, TwistStamped
from nodes.process import DEADLINE, Graph, LATCHED
import numpy as np
import pytest
from shepherd_ros.console import drives
from shepherd_ros.console.messages import MESSAGE_KINDS
from shepherd_ros.console.page_server import PageServer
from shepherd_ros.nodes import console_calls
from shepherd_ros.nodes.console_calls import Done
from shepherd_ros.nodes.console_node import ConsoleNode
from shepherd_ros.recordings.episodes import iter_episodes
from shepherd_ros.ros.runtime import EXIT_USAGE
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.wire.episode import Episode
from std_msgs.msg import String
from tornado.httpclient import HTTPClientError
from tornado.websocket import WebSocketClosedError
from view.browser import chromium, Reader

pytestmark = pytest.mark.xdist_group('console')  # one graph for all
SLOW = pytest.mark.timeout(240)  # processes that import torch


@pytest.fixture(scope='module')
def sim(shared_graph: Graph) -> Any:
    """Run a small world that two sources can drive, through mux."""
    shared_graph.host('lidar', n_rays=32, shepherd_ids=[-1])
    shared_graph.host('metrics')
    for name in ('strombom', 'idle'):
        remaps = (f'shepherd_{h}/cmd_vel:=shepherd_{h}/cmd_vel/{name}' for h in range(2))
        shared_graph.host(name, *(word for remap in remaps for word in ('-r', remap)))
    sources = {'topics.idle.priority': 5, 'topics.idle.answers': True}
    sources |= {'topics.console.timeout': 3.0}  # a busy machine sends a page's commands late
    shared_graph.host('mux', default='strombom', **sources)
    return shared_graph.host(
        'flock_sim', n_sheep=12, n_shepherds=2, episode_steps=100_000, rate=100.0
    )


@pytest.fixture(scope='module')
def record_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the bags."""
    return tmp_path_factory.mktemp('bags')


@pytest.fixture(scope='module')
def console(
    shared_graph: Graph, sim: Any, record_dir: Path, commands: Path
) -> Iterator[ConsoleNode]:
    """Run a console, whose recorder and jobs are forks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(console_calls, 'ANSWER_LIMIT', DEADLINE)
        patch.setattr(sys, 'executable', str(commands / 'python'))
        node = shared_graph.host('console', port=0, record_dir=str(record_dir))
        shared_graph.until(lambda: node.address, 'the console listens')
        yield node


@pytest.fixture
def page(shared_graph: Graph, console: ConsoleNode) -> Iterator[TestPage]:
    """Open a page of a graph that it knows whole."""
    opened = TestPage(console.address)
    shared_graph.until(
        lambda: (
            opened.last('drivers').get('drivers')
            and opened.last('world').get('settings')
            and opened.frames
        ),
        lambda: (
            f'all of {len(opened.frames)} frames, {opened.last("drivers")}, {opened.last("world")}'
        ),
    )
    yield opened
    opened.close()


def ask(graph: Graph, page: TestPage, do: str, **fields: Any) -> str:
    """Return the text of the answer to a command that is done."""
    answer = page.ask(graph.until, do, **fields)
    assert answer['ok'], answer
    return answer['text']


def refused(graph: Graph, page: TestPage, do: str, **fields: Any) -> str:
    """Return the text of the answer to a command that is not done."""
    answer = page.ask(graph.until, do, **fields)
    assert not answer['ok'], answer
    return answer['text']


# --- what a page is shown -----------------------------------------------------------------------


def test_a_page_gets_what_the_world_says(shared_graph: Graph, page: TestPage) -> None:
    track = shared_graph.track()
    assert ask(shared_graph, page, 'watch', shepherd=1) == 'lidar of shepherd 1'
    shared_graph.until(lambda: page.frames[-1].lidar == 1, 'a frame with ranges')
    shared_graph.until(
        lambda: any(round(f.time * 1e9) in track.stamps for f in page.frames), 'the same states'
    )
    shared_graph.forget(track)
    for frame in page.frames:
        ns = round(frame.time * 1e9)
        if ns in track.stamps:
            np.testing.assert_array_equal(frame.sheep, track.sheep(ns).numpy())
            np.testing.assert_array_equal(frame.shepherds, track.shepherds(ns).numpy())
    assert page.frames[-1].ranges.shape == (3, 32)
    steps = [frame.step for frame in page.frames]
    assert steps == sorted(steps)
    assert [frame.number for frame in page.frames] == list(range(1, len(steps) + 1))
    assert set(page.order) - {'frame'} <= MESSAGE_KINDS.keys()


def test_a_browser_draws_a_state(
    shared_graph: Graph, console: ConsoleNode, tmp_path: Path
) -> None:
    track, driver = shared_graph.track(), chromium(tmp_path)
    try:
        reader = Reader(driver)
        reader.open(console.address)
        shared_graph.until(lambda: reader.run('return LIVE.frame !== null'), 'a state is drawn')
        shown: dict[int, list[float]] = {}  # of some, as the track may have missed one

        def heard() -> bool:
            words = 'const {time, sheep} = LIVE.frame; return [time, [...sheep]]'
            time_s, sheep = reader.run(words)
            shown[round(time_s * 1e9)] = sheep
            return any(ns in track.stamps for ns in shown)

        shared_graph.until(heard, 'the same state')
        ns = next(ns for ns in shown if ns in track.stamps)
        np.testing.assert_allclose(np.reshape(shown[ns], (-1, 2)), track.sheep(ns).numpy())
        assert len(reader.painted()[1]) == 2
        assert reader.complaints() == []
    finally:
        shared_graph.forget(track)
        driver.quit()


def test_a_late_page_gets_what_is_latched(shared_graph: Graph, page: TestPage) -> None:
    latched = [name for name, kind in MESSAGE_KINDS.items() if kind.latched and name != 'bags']
    late = TestPage(page.address)
    shared_graph.until(lambda: late.frames and all(map(late.last, latched)), 'all of it')
    assert late.order[0] == 'hello'
    for kind in ('episode', 'world', 'drivers', 'recording', 'value_map'):
        assert late.last(kind) == page.last(kind)
        assert late.last(kind).keys() - {'type'} >= MESSAGE_KINDS[kind].fields.keys()
    assert late.last('hello')['page'] != page.last('hello')['page']
    curves = late.last('curves')
    assert {len(v) for v in curves['values'].values()} == {len(curves['steps'])}
    shared_graph.until(lambda: page.last('pages')['count'] == 2, 'two pages')
    late.close()
    shared_graph.until(lambda: page.last('pages')['count'] == 1, 'one page')


def test_a_page_that_does_not_read_gets_the_newest_and_holds_nobody_up(
    shared_graph: Graph, page: TestPage, console: ConsoleNode
) -> None:
    lazy = TestPage(page.address, reads=False)
    begun = len(page.frames)
    shared_graph.until(lambda: len(page.frames) > begun + 60, 'the other page goes on')
    number = lazy_number(console, page)
    assert console.desk.sessions[number].sent <= 2
    lazy.read()
    shared_graph.until(lambda: len(lazy.frames) > 3, 'it reads')
    first, second, third = (frame.step for frame in lazy.frames[:3])
    assert first <= second < third
    assert third - second > 30  # those between were never sent
    lazy.close()


def lazy_number(console: ConsoleNode, page: TestPage) -> int:
    """Return the number of the page that is not this one."""
    (number,) = console.desk.sessions.keys() - {page.last('hello')['page']}
    return number


# --- access -------------------------------------------------------------------------------------


def status(console: ConsoleNode, path: str, **headers: str) -> tuple[int, str]:
    """Return status and text of a request."""
    request = Request(console.address + path, headers=headers)
    try:
        with urlopen(request, timeout=ANSWER) as answer:
            return answer.status, answer.read().decode()
    except HTTPError as error:
        return error.code, error.read().decode()


def test_the_page_and_its_files_are_served_to_this_machine_alone(console: ConsoleNode) -> None:
    code, text = status(console, '')
    assert code == 200
    files = re.findall(r'(?:src|href)="([\w.-]+\.(?:js|css))"', text)
    assert files
    for name in files:
        assert status(console, name)[0] == 200
    for path in ('none.js', 'page.py', '..%2fpage.py', '__init__.py', 'ws/x'):
        assert status(console, path)[0] == 404
    for headers in ({'Host': 'evil.example'}, {'Origin': 'http://evil.example'}):
        for path in ('', 'console.js', 'ws'):
            code, text = status(console, path, **headers)
            assert code == 403
            assert 'expected' in text
    with pytest.raises(HTTPClientError, match='403'):
        TestPage(console.address, Origin='http://evil.example')


def test_a_port_that_is_taken_is_named(shared_graph: Graph, console: ConsoleNode) -> None:
    assert console.server is not None
    port = console.server.port
    process = shared_graph.start('console', '-r', '__node:=second', port=port)
    assert process.wait() == EXIT_USAGE
    assert re.search(f'and port {port}: expected .* that is free', process.text), process
    assert 'Traceback' not in process.text


def test_elsewhere_than_on_loopback_a_token_is_needed(
    shared_graph: Graph, console: ConsoleNode
) -> None:
    node = shared_graph.host('console', '-r', '__node:=open', port=0, host='0.0.0.0')
    shared_graph.until(lambda: node.address, 'it listens')
    address, token = node.address.split('?token=')
    assert status(console, '')[0] == 200  # which needs none
    with pytest.raises(HTTPError, match='403'):
        urlopen(address, timeout=ANSWER)
    with pytest.raises(HTTPClientError, match='403'):
        TestPage(address)
    with urlopen(node.address, timeout=ANSWER) as answer:
        cookie = answer.headers['Set-Cookie'].split(';')
    assert {' HttpOnly', ' SameSite=Strict'} <= set(cookie)
    with urlopen(
        Request(f'{address}console.js', headers={'Cookie': cookie[0]}), timeout=ANSWER
    ) as a:
        assert a.status == 200
    page = TestPage(f'{address}?token={token}')
    shared_graph.until(lambda: page.last('hello'), 'it is let in')
    page.close()
    shared_graph.end(node)
    node.in_executor(lambda: pytest.fail('the node has ended'))
    shared_graph.spin()


def test_garbage_closes_its_own_page_alone(
    shared_graph: Graph, page: TestPage, console: ConsoleNode
) -> None:
    bad = TestPage(page.address)
    bad.send_raw('{')
    bad.send_raw(b'\xff' * 1000)
    shared_graph.until(lambda: len(bad.messages['answer']) == 2, 'two answers')
    assert all(not answer['ok'] for answer in bad.messages['answer'])
    with suppress(WebSocketClosedError):
        bad.send_raw('x' * 2_000_000)
    shared_graph.until(lambda: bad.disconnected, 'it is closed')
    begun = len(page.frames)
    shared_graph.until(lambda: len(page.frames) > begun + 5, 'the other page goes on')
    shared_graph.until(lambda: len(console.desk.sessions) == 1, 'it is forgotten')
    bad.close()


def test_pages_that_come_and_go_leave_nothing(
    shared_graph: Graph, page: TestPage, console: ConsoleNode
) -> None:
    for _ in range(20):
        other = TestPage(page.address)
        other.send('watch', shepherd=0)
        shared_graph.until(lambda other=other: other.frames, 'a frame')
        other.close()
    shared_graph.until(lambda: len(console.desk.sessions) == 1, 'they are forgotten')
    shared_graph.until(lambda: not console.feed.scans, 'their lidars, too')
    assert not console.archive.files
    assert not console.archive.owners
    assert console.server is not None
    assert len(console.server.application.settings['sockets']) == 1


# --- the world ----------------------------------------------------------------------------------


def test_pause_step_and_resume(shared_graph: Graph, page: TestPage, sim: Any) -> None:
    assert ask(shared_graph, page, 'pause') == 'paused'
    shared_graph.until(lambda: page.last('world')['paused'] is True, 'it is told')
    shared_graph.until(lambda: sim.flock_commands.complete, 'the answers to the last state')
    now = sim.now_ns
    assert ask(shared_graph, page, 'step', steps=3) == '3 steps, then paused'
    shared_graph.until(lambda: sim.now_ns == now + 3 * sim.dt_ns, 'three steps')
    shared_graph.until(
        lambda: round(page.frames[-1].time * 1e9) == sim.now_ns, 'a frame of the last state'
    )
    assert ask(shared_graph, page, 'resume') == 'running'
    shared_graph.until(lambda: sim.now_ns > now + 9 * sim.dt_ns, 'it goes on')


def test_reset_with_a_seed_and_settings_of_the_next_episode(
    shared_graph: Graph, page: TestPage, sim: Any
) -> None:
    output = shared_graph.collect('episode', String, LATCHED)
    settings = page.last('world')['settings']
    assert settings['n_sheep'] | {'value': 12} == settings['n_sheep']
    assert 'reynolds' in settings['flock']['choices']
    values = {'n_sheep': 9, 'n_shepherds': 3, 'flock': 'reynolds', 'goal_radius': 3}
    assert 'n_sheep 9' in ask(shared_graph, page, 'settings', values=values)
    shared_graph.until(
        lambda: page.last('world')['settings']['n_sheep']['value'] == 9, 'it is told'
    )
    assert 'seed 77' in ask(shared_graph, page, 'reset', seed=77)
    shared_graph.until(
        lambda: output and Episode.from_json(output[-1].data).seed == 77, 'the episode'
    )
    episode = Episode.from_json(output[-1].data)
    assert (episode.n_sheep, episode.goal_radius) == (9, 3.0)
    assert episode.world['flock']['model'] == 'reynolds'
    shared_graph.until(lambda: page.last('episode')['seed'] == 77, 'the page knows')
    page.send('watch', shepherd=2)
    shared_graph.until(
        lambda: page.frames[-1].sheep.shape == (9, 2) and page.frames[-1].lidar == 2,
        'and shows it, the new shepherd with its lidar',
    )
    back = {'n_sheep': 12, 'n_shepherds': 2, 'flock': 'strombom', 'goal_radius': 4.0}
    ask(shared_graph, page, 'settings', values=back)
    assert 'seed 78' in ask(shared_graph, page, 'reset')


def test_settings_that_are_not_answered_are_asked_for_again(
    shared_graph: Graph, page: TestPage, console: ConsoleNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    world, lost = console.world, ['describe_parameters', 'get_parameters']
    call = world.calls.call

    def lose(server: PageServer, name: str, request: Any, done: Done) -> None:
        if lost and name.endswith(lost[0]):
            lost.pop(0)
            done(None, 'no answer')
        else:
            call(server, name, request, done)

    shared_graph.until(lambda: world.current and not world.asking, 'no answer is under way')
    monkeypatch.setattr(world.calls, 'call', lose)
    assert console.server
    console.server.call(world.refresh)
    shared_graph.until(lambda: not lost and world.current, 'they are known again')
    assert page.last('world')['settings']


def test_the_pace_and_the_goal(shared_graph: Graph, page: TestPage, sim: Any) -> None:
    goals = shared_graph.collect('goal', PoseStamped, LATCHED)
    assert ask(shared_graph, page, 'rate', rate=50) == '50 steps per second'
    assert sim.rate == 50.0
    shared_graph.until(lambda: page.last('world')['rate'] == 50.0, 'it is told')
    ask(shared_graph, page, 'rate', rate=100.0)
    ask(shared_graph, page, 'goal', x=2.5, y=-1.0)
    shared_graph.until(lambda: goals and goals[-1].pose.position.x == 2.5, 'the goal moves')
    shared_graph.until(lambda: page.frames[-1].goal == (2.5, -1.0), 'and is shown')


def test_what_cannot_be_is_refused_in_words(shared_graph: Graph, page: TestPage) -> None:
    for do, fields, words in (
        ('dance', {}, 'do is .dance.: expected one of'),
        ('step', {}, 'step lacks steps'),
        ('step', {'steps': 0}, 'steps is 0: expected'),
        ('step', {'steps': '3'}, 'expected int'),
        ('pause', {'now': True}, 'field of pause is .now.'),
        ('goal', {'x': 1e40, 'y': 0}, 'x is'),
        ('settings', {'values': {'dt': 0.1}}, 'setting is .dt.: expected one of n_sheep'),
        ('settings', {'values': {'n_sheep': -3}}, 'n_sheep'),
        ('settings', {'values': {'flock': 'goats'}}, 'goats'),
        ('driver', {'shepherd': 0, 'source': 'nobody'}, 'source is .nobody.'),
        ('driver', {'shepherd': 9, 'source': 'idle'}, 'shepherd is 9: expected 0 to 1'),
        ('drive', {'shepherd': 7, 'x': 0.0, 'y': 0.0}, 'shepherd is 7'),
        ('replay', {'bag': '../bags'}, 'expected the name of one in'),
        ('replay', {'bag': 'none'}, 'expected the name of one in'),
        ('stop_recording', {}, 'nothing is being recorded'),
        ('cancel', {'job': 99}, 'job is 99'),
    ):
        text = refused(shared_graph, page, do, **fields)
        assert re.search(words, text), text


# --- who drives ---------------------------------------------------------------------------------


def test_a_page_chooses_who_drives_and_locks(shared_graph: Graph, page: TestPage) -> None:
    assert {'strombom', 'idle', 'console'} <= set(page.last('drivers')['sources'])
    assert {'strombom', 'idle'} <= set(page.last('drivers')['active'])

    def drivers(*names: str | None) -> None:
        shared_graph.until(
            lambda: page.last('drivers')['drivers'] == list(names),
            lambda: f'{names} drive: {page.last("drivers")}',
        )

    ask(shared_graph, page, 'driver', shepherd=1, source='idle')
    drivers('strombom', 'idle')
    sources = page.last('drivers')['sources']
    shared_graph.until(
        lambda: (
            page.frames[-1].driver.tolist() == [sources.index(n) for n in ('strombom', 'idle')]
        ),
        'frames say it, too',
    )
    ask(shared_graph, page, 'driver', shepherd=-1, source='auto')
    drivers('strombom', 'strombom')
    ask(shared_graph, page, 'lock', locked=True)
    drivers(None, None)
    ask(shared_graph, page, 'lock', locked=False, shepherd=1)
    drivers(None, 'strombom')
    ask(shared_graph, page, 'lock', locked=False)
    drivers('strombom', 'strombom')
    assert '0 to 1' in refused(shared_graph, page, 'lock', locked=True, shepherd=2)


def test_a_shepherd_stops_when_its_page_is_silent(shared_graph: Graph, page: TestPage) -> None:
    velocities: list[tuple[float, float]] = []

    def hear(command: TwistStamped) -> None:
        velocities.append((time.monotonic(), command.twist.linear.x))

    hearing = shared_graph.node.create_subscription(
        TwistStamped, 'shepherd_0/cmd_vel/console', hear, 100
    )
    shared_graph.until(lambda: hearing.get_publisher_count() == 1, 'the console publishes')
    sent = time.monotonic()
    page.send('drive', shepherd=0, x=0.5, y=0.0)
    shared_graph.until(lambda: velocities and velocities[-1][1] == 0.0, 'zero')
    assert [x for _, x in velocities] == [0.5, 0.0]
    assert velocities[-1][0] - sent > drives.DEAD_MAN
    shared_graph.until(lambda: page.last('pages')['driven'] == {}, 'it is released')
    shared_graph.node.destroy_subscription(hearing)


@pytest.mark.parametrize('ending', ['blur', 'release', 'close'])
def test_a_page_takes_a_shepherd_by_hand_and_gives_it_back(
    shared_graph: Graph,
    page: TestPage,
    sim: Any,
    ending: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(drives, 'DEAD_MAN', DEADLINE)
    monkeypatch.setattr(drives, 'GIVE_BACK_AFTER', DEADLINE)
    ask(shared_graph, page, 'driver', shepherd=0, source='idle')
    shared_graph.until(lambda: page.last('drivers')['drivers'][0] == 'idle', 'idle drives')
    commands = shared_graph.collect('shepherd_0/cmd_vel/console', TwistStamped)
    other = TestPage(page.address)

    def held() -> bool:
        other.send('drive', shepherd=0, x=0.5, y=-0.25)
        shared_graph.idle(0.05)
        return page.last('drivers')['drivers'][0] == 'console' and bool(commands)

    before = sim.state.shepherds[0].tolist()
    shared_graph.until(held, 'the page drives')

    def refusal() -> str:  # for as long as the other drives
        held()
        answer = page.ask(shared_graph.until, 'drive', shepherd=0, x=0.0, y=0.0)
        return '' if answer['ok'] else answer['text']

    assert 'driven from page' in shared_graph.until(refusal, 'this page is refused')

    def moved() -> bool:
        x, y = sim.state.shepherds[0].tolist()
        return x > before[0] + 0.4 and y < before[1] - 0.2

    shared_graph.until(lambda: held() and moved(), lambda: f'it moves: {page.last("drivers")}')
    assert {(c.twist.linear.x, c.twist.linear.y) for c in commands} <= {(0.5, -0.25), (0.0, 0.0)}
    if ending == 'close':
        other.close()
    else:
        other.send(ending)
    shared_graph.until(
        lambda: (commands[-1].twist.linear.x, commands[-1].twist.linear.y) == (0.0, 0.0),
        'zero is published',
    )
    shared_graph.until(lambda: page.last('drivers')['drivers'][0] == 'idle', 'idle again')
    if ending != 'close':
        other.close()
    ask(shared_graph, page, 'driver', shepherd=-1, source='auto')


# --- bags ---------------------------------------------------------------------------------------


@SLOW
@pytest.mark.system
def test_a_recording_is_whole_and_is_replayed(
    shared_graph: Graph, page: TestPage, record_dir: Path
) -> None:
    ask(shared_graph, page, 'rate', rate=5.0)  # at which no machine is too busy to record
    before = len(page.frames)
    shared_graph.until(lambda: len(page.frames) > before + 3, 'everything is compiled')
    assert 'recording into' in ask(shared_graph, page, 'record')
    shared_graph.until(lambda: page.last('recording')['state'] == 'on', 'it is told')
    assert 'is being recorded' in refused(shared_graph, page, 'record')
    ask(shared_graph, page, 'settings', values={'episode_steps': 60})
    ask(shared_graph, page, 'reset', seed=3)
    shared_graph.until(
        lambda: page.last('episode')['seed'] == 3 and page.frames[-1].step > 15, 'some'
    )
    assert 'the bag is whole' in ask(shared_graph, page, 'stop_recording')
    name = page.last('recording')['bag']
    assert page.last('recording')['state'] == 'off'
    (episode,) = (e for e in iter_episodes(open_bag(record_dir / name)) if e.seed == 3)
    assert episode.frames[0].step == 0
    ask(shared_graph, page, 'settings', values={'episode_steps': 100_000})
    ask(shared_graph, page, 'rate', rate=100.0)
    ask(shared_graph, page, 'reset')

    assert ask(shared_graph, page, 'list_bags') == '1 bags'
    (bag,) = page.last('bags')['bags']
    assert bag['name'] == name
    which = [e['seed'] for e in bag['episodes']].index(3)
    ask(shared_graph, page, 'replay', bag=name, episode=which)
    shared_graph.until(lambda: page.last('job').get('state') in ('done', 'failed'), 'a replay')
    (track,) = page.last('job')['result']['tracks']
    record = json.loads(page.fetch(track['url']))
    assert record['steps']['shape'] == [len(episode.frames)]

    ask(shared_graph, page, 'counterfactual', bag=name, episode=which, step=10, controller='idle')
    shared_graph.until(
        lambda: (
            page.last('job').get('kind') == 'counterfactual'
            and page.last('job')['state'] in ('done', 'failed')
        ),
        lambda: f'another future: {page.last("job")}',
        200,
    )
    assert page.last('job')['state'] == 'done', page.last('job')
    result = page.last('job')['result']
    assert (len(result['tracks']), result['parting']) == (2, 10)
    assert all(len(row['values']) == 2 for row in result['table'])


@SLOW
def test_values_of_places_while_they_are_wanted(
    shared_graph: Graph, page: TestPage, console: ConsoleNode
) -> None:
    ask(shared_graph, page, 'value_map', on=True, checkpoint='strombom', shepherd=1)
    shared_graph.until(
        lambda: page.last('value_map').get('values') or page.last('value_map').get('text'),
        'a map', 200,
    )  # fmt: skip
    shared_graph.until(lambda: page.last('value_map')['values'], 'a map', 200)
    values = np.array(page.last('value_map')['values'])
    assert values.shape == (41, 41)
    assert np.isfinite(values).all()
    assert values.std() > 0
    ask(shared_graph, page, 'value_map', on=False)
    shared_graph.until(lambda: page.last('value_map')['on'] is False, 'none')
    assert not console.values.job


# --- everything ---------------------------------------------------------------------------------


def children_of(parent: int) -> list[int]:
    """Return the processes that a process has started."""
    pids = []
    for path in Path('/proc').glob('[0-9]*/stat'):
        with suppress(OSError):  # it has ended meanwhile
            if int(path.read_text().rpartition(')')[2].split()[1]) == parent:
                pids.append(int(path.parent.name))
    return pids


@pytest.mark.system
def test_one_command_starts_everything_and_ends_it(graph: Graph, tmp_path: Path) -> None:
    words = '--controller idle --standby strombom --sheep 8 --shepherds 2 --port 0 --record-dir'
    process = graph.start_words('shepherd', ['console', *words.split(), str(tmp_path)])
    opened = TestPage(graph.until_says(process, r'open (http\S+)')[1])
    graph.until(
        lambda: opened.frames and opened.last('drivers').get('drivers') == ['idle', 'idle'],
        'the page shows it',
    )
    ask(graph, opened, 'driver', shepherd=1, source='strombom')
    graph.until(lambda: opened.last('drivers')['drivers'][1] == 'strombom', 'another drives')
    opened.close()
    started = children_of(process.pid)
    assert len(started) >= 6  # world, lidar, metrics, mux, console, controllers
    assert process.stop() == 0
    graph.until(lambda: not any(Path(f'/proc/{pid}').exists() for pid in started), 'all ended')
