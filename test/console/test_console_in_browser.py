"""The console in Chromium against a running graph: each control, and what it does there."""

from __future__ import annotations

from collections.abc import Iterator
import json
from pathlib import Path
import sys
from threading import Event, Thread
import time
from urllib.parse import urlsplit

from console.console_page import ConsolePage
from geometry_msgs.msg import PoseStamped, TwistStamped
from nodes.process import Graph, LATCHED, until
import numpy as np
from numpy.testing import assert_allclose
import pytest
from selenium.webdriver import ActionChains, Keys
from shepherd_ros.console import drives
from shepherd_ros.recordings.episodes import iter_episodes
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.wire.decode import decode_string
from shepherd_ros.wire.episode import Episode
from std_msgs.msg import String
from view.browser import chromium, PATIENCE

pytestmark = [
    pytest.mark.system,
    pytest.mark.xdist_group('browser'),  # one browser for all
]
RATE = 10.0  # steps per second
JOB = 110.0  # [s] for what a process with torch does, on a busy machine
SPEED = 1.0  # [m/s] of a shepherd
SMALL = """
return [...document.querySelectorAll('button, select, input, [role=tab]')]
  .filter((item) => item.offsetParent && item.type !== 'checkbox')
  .filter((item) => item.getBoundingClientRect().height < 40)
  .map((item) => item.outerHTML.slice(0, 100));
"""  # targets too small for a finger
TABS = ('world', 'bags', 'nodes', 'metrics', 'team')


class Herding:
    """A graph whose nodes run in a thread, with a page of its console, and what it says."""

    def __init__(self, graph: Graph, page: ConsolePage, bags: Path) -> None:
        """Start the nodes."""
        self.graph, self.page, self.bags = graph, page, bags
        world = {'n_sheep': 15, 'n_shepherds': 2, 'episode_steps': 100_000, 'rate': RATE}
        self.flock_sim = graph.host('flock_sim', **world)
        graph.host('lidar', n_rays=64, shepherd_ids=[0, 1])
        graph.host('metrics')
        for name in ('strombom', 'drover'):
            graph.host(name, source=name)
        sources = {'topics.drover.answers': True, 'topics.drover.priority': 9}
        sources |= {'topics.console.timeout': 2.0}
        self.mux = graph.host('mux', default='strombom', **sources)
        self.console = graph.host('console', port=0, record_dir=str(bags))
        self.track = graph.track()
        self.episodes = graph.collect('episode', String, LATCHED)
        self.goals = graph.collect('goal', PoseStamped, LATCHED)
        self.drivers = graph.collect('drivers', String, LATCHED)
        self.commands = [graph.collect(f'shepherd_{h}/cmd_vel', TwistStamped) for h in range(3)]
        self._end = Event()
        self._thread = Thread(target=self._spin, daemon=True)
        graph.spin = lambda: time.sleep(0.01)  # type: ignore[method-assign]
        self._thread.start()

    def _spin(self) -> None:
        while not self._end.is_set():
            self.graph.executor.spin_once(timeout_sec=0.01)

    def close(self) -> None:
        """End the thread."""
        self._end.set()
        self._thread.join()

    @property
    def episode(self) -> Episode:
        return Episode.from_json(self.episodes[-1].data)

    @property
    def driven(self) -> list[str | None]:
        return json.loads(self.drivers[-1].data)['drivers'] if self.drivers else []

    def velocity(self, shepherd: int) -> tuple[float, float]:
        """Return the last command of a shepherd [m/s]."""
        linear = self.commands[shepherd][-1].twist.linear
        return linear.x, linear.y

    def until_moved(self, shepherd: int, x: float, y: float) -> None:
        """Wait until a shepherd is commanded so."""
        until(
            lambda: np.allclose(self.velocity(shepherd), (x, y), atol=1e-6),
            lambda: f'{(x, y)} m/s, not {self.velocity(shepherd)}',
        )

    def set_steps(self, steps: int) -> None:
        """Begin an episode of so many steps by the page."""
        self.page.tab('world')
        self.page.write('[name=episode_steps]', str(steps))
        self.page.click('[name=reset]')
        until(lambda: self.episode.episode_steps == steps, f'an episode of {steps} steps')

    def until_steps(self, n: int) -> None:
        """Wait until the world has made so many steps more."""
        before = len(self.track.shown)
        until(lambda: len(self.track.shown) >= before + n, f'{n} steps')


@pytest.fixture(scope='module')
def herding(
    shared_graph: Graph, commands: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Herding]:
    """Run a world with two controllers, a mux and a console, open in a browser."""
    patch = pytest.MonkeyPatch()  # a machine that is busy would let go of what a page drives
    patch.setattr(drives, 'DEAD_MAN', PATIENCE)
    patch.setattr(drives, 'GIVE_BACK_AFTER', PATIENCE)
    patch.setattr(sys, 'executable', str(commands / 'python'))  # recorder and jobs are forks
    driver = chromium(tmp_path_factory.mktemp('profile'))
    page = ConsolePage(driver)
    own = Herding(shared_graph, page, tmp_path_factory.mktemp('bags'))
    try:
        until(lambda: own.console.address, 'the console listens')
        page.open_console(own.console.address)
        yield own
    finally:
        own.close()
        driver.quit()
        patch.undo()


@pytest.fixture
def page(herding: Herding) -> Iterator[ConsolePage]:
    """Lend the page; nothing may have been wrong afterwards, and nothing left the machine."""
    page = herding.page
    page.tab('team')
    yield page
    page.press(Keys.ESCAPE)  # gives back what is driven
    assert page.texts('#alerts p') == []
    assert page.complaints() == []
    requested = {url for url in page.requests() if url.startswith(('http', 'ws'))}
    assert {urlsplit(url).netloc for url in requested} <= {
        urlsplit(herding.console.address).netloc
    }


def test_it_shows_the_newest_state(herding: Herding, page: ConsolePage) -> None:
    page.choose('#whose', 'shepherd 1')
    page.until(lambda: page.run('return LIVE.frame.lidar') == 1, 'there are ranges')
    frame = page.run('const {time, sheep} = LIVE.frame; return [time, [...sheep]]')
    ns = round(frame[0] * 1e9)
    until(lambda: ns in herding.track.stamps, 'the same state')
    assert_allclose(np.reshape(frame[1], (-1, 2)), herding.track.sheep(ns).numpy())
    assert page.run('return PLANE.moment.rays.channels.length') == 3
    assert page.text('#link') == 'Live'
    assert page.text('#facts') == 'Episode 0, seed 0: 15 sheep, 2 shepherds'
    page.until(lambda: page.run('return LIVE.steps.length') > 2, 'curves grow')
    page.until(lambda: page.texts('#metrics .curve h2') != [], 'they are named')
    assert [t.splitlines()[0] for t in page.texts('#metrics .curve h2')] == [
        'completion time [steps]', 'shepherd path length [m]', 'flock path length [m]',
        'flock spread [m]', 'fraction reached',
    ]  # fmt: skip
    page.tab('nodes')
    page.until(lambda: len(page.texts('#reports summary')) > 5, 'nodes report')
    page.tab('team')


# ---- the world ----


def test_it_pauses_steps_and_goes_on(herding: Herding, page: ConsolePage) -> None:
    go = page.find('#go')
    page.until(lambda: go.get_attribute('aria-label') == 'Pause', 'the world runs')
    page.click('#go')
    page.until(lambda: go.get_attribute('aria-label') == 'Start', 'it is paused')
    page.until(lambda: page.stamp() == herding.track.last, 'all drawn')
    before = herding.track.last
    page.click('#step')
    until(lambda: herding.track.last > before, 'a step')
    page.click('#step')
    until(lambda: herding.track.last > before + 0.5e9, 'a second step')
    time.sleep(0.3)  # no third one
    assert herding.track.last == before + 1e9
    page.click('#go')
    page.until(lambda: go.get_attribute('aria-label') == 'Pause', 'it goes on')
    herding.until_steps(3)


def test_a_reset_begins_an_episode_with_a_seed_or_the_next(
    herding: Herding, page: ConsolePage
) -> None:
    page.write('#seed', '41')
    page.click('#reset')
    until(lambda: herding.episode.seed == 41, 'the episode of the seed')
    page.until(lambda: 'seed 41:' in page.text('#facts'), 'the page says so')
    page.click('#reset')
    until(lambda: herding.episode.seed == 42, 'the next one')
    page.until(lambda: page.run('return LIVE.frame.episode') == herding.episode.number, 'drawn')


def test_what_the_server_refuses_is_said_in_words(herding: Herding, page: ConsolePage) -> None:
    page.write('#seed', '1.5')
    page.click('#reset')
    assert 'seed is 1.5' in page.alert()
    page.write('#seed', Keys.DELETE)


def test_the_speed_is_that_of_the_menu(herding: Herding, page: ConsolePage) -> None:
    page.choose('#rate', '50 steps/s')
    until(lambda: herding.flock_sim.get_parameter('rate').value == 50.0, 'the rate of the world')
    page.choose('#rate', f'{RATE:g} steps/s')
    until(lambda: herding.flock_sim.get_parameter('rate').value == RATE, 'the rate of before')


def test_the_next_episode_is_as_the_form_says(herding: Herding, page: ConsolePage) -> None:
    page.tab('world')
    before = herding.episode.number
    page.write('[name=n_sheep]', '20')
    page.write('[name=n_shepherds]', '3')
    page.write('[name=goal_radius]', '3.5')
    page.choose('[name=flock]', 'reynolds')
    page.choose('[name=preset]', 'fine_dt')
    page.click('[name=later]')
    page.until(lambda: page.text('#said') != '', 'the settings are taken')
    assert herding.episode.number == before
    page.click('[name=reset]')
    until(lambda: herding.episode.number == before + 1, 'the next episode')
    episode = herding.episode
    assert (episode.n_sheep, episode.n_shepherds, episode.goal_radius) == (20, 3, 3.5)
    assert episode.world['flock']['model'] == 'reynolds'
    page.until(lambda: '20 sheep, 3 shepherds' in page.text('#facts'), 'the page says so')
    page.tab('team')
    page.until(lambda: len(page.texts('#shepherds li')) == 3, 'three shepherds are listed')
    page.tab('world')
    page.write('[name=n_sheep]', '0')
    page.click('[name=later]')
    assert 'n_sheep out of range. Min: 1' in page.alert()
    page.write('[name=n_sheep]', '20')
    page.tab('team')


def test_the_goal_goes_where_it_is_dragged(herding: Herding, page: ConsolePage) -> None:
    goal = herding.goals[-1].pose.position
    page.click('[aria-label="Zoom out"]')  # from here on the view stays as it is
    start = np.array([goal.x + herding.episode.goal_radius, goal.y])
    page.drag(start, start + np.array([2.0, 1.0]))
    metre = 1.5 / page.zoom()  # what a pixel and a half are
    until(lambda: herding.goals[-1].pose.position != goal, 'the goal has moved')
    moved = herding.goals[-1].pose.position
    assert_allclose([moved.x, moved.y], [goal.x + 2, goal.y + 1], atol=metre)
    page.until(lambda: abs(page.run('return PLANE.moment.goal[0]') - moved.x) < 1e-4, 'drawn')
    page.click('[aria-label="Fit all in view"]')
    page.find('#plane').send_keys('')
    ActionChains(page.driver).key_down(Keys.SHIFT).send_keys(Keys.LEFT).key_up(
        Keys.SHIFT
    ).perform()
    until(lambda: abs(herding.goals[-1].pose.position.x - moved.x + 0.5) < 1e-6, 'half a metre')


# ---- drivers ----


def test_each_shepherd_has_the_driver_that_is_chosen(herding: Herding, page: ConsolePage) -> None:
    until(lambda: set(herding.driven[:2]) == {'strombom'}, 'the default drives all')
    page.choose('#shepherds li:nth-child(2) select', 'drover')
    until(lambda: herding.driven[:2] == ['strombom', 'drover'], 'another one drives shepherd 1')
    page.until_text('#shepherds li:nth-child(2) .who', lambda text: text == 'Shepherd 1\ndrover')
    page.choose('#everyone', 'drover')
    until(lambda: herding.driven[:2] == ['drover'] * 2, 'it drives all')
    page.choose('#everyone', 'auto')
    until(lambda: herding.driven[:2] == ['strombom'] * 2, 'the default drives again')


def test_all_shepherds_stand_still_while_they_are_stopped(
    herding: Herding, page: ConsolePage
) -> None:
    page.click('#lock')
    page.until_text('#lock', lambda text: text == 'Let shepherds go')
    until(lambda: set(herding.driven) == {None}, 'nobody drives')
    herding.until_steps(2)
    assert [herding.velocity(h) for h in range(2)] == [(0.0, 0.0)] * 2
    page.click('#lock')
    until(lambda: None not in herding.driven, 'they are driven again')


def test_one_shepherd_stands_still_while_it_is_stopped(
    herding: Herding, page: ConsolePage
) -> None:
    until(lambda: herding.driven[:2] == ['strombom'] * 2, 'the default drives all')
    stop = page.find('#shepherds li:nth-child(2) .stop')
    assert stop.accessible_name == 'Stop shepherd 1'
    stop.click()
    until(lambda: herding.driven[:2] == ['strombom', None], 'nobody drives shepherd 1')
    herding.until_moved(1, 0.0, 0.0)
    page.until_text('#shepherds li:nth-child(2) .who', lambda text: text.endswith('locked'))
    assert page.text('#lock') == 'Stop all shepherds'
    assert stop.accessible_name == 'Let shepherd 1 go'
    stop.click()
    until(lambda: herding.driven[:2] == ['strombom'] * 2, 'it is driven again')


def test_the_speed_by_hand_is_that_of_the_field_and_a_button_gives_back(
    herding: Herding, page: ConsolePage
) -> None:
    page.write('#speed', '0.5' + Keys.ENTER)
    page.take(0)
    page.run('document.activeElement.blur()')
    page.hold('w')
    herding.until_moved(0, 0.0, 0.5 * SPEED)
    page.let_go('w')
    page.click('#give')
    until(lambda: herding.driven[0] == 'strombom', 'it is given back')
    assert not page.find('#driving').is_displayed()
    page.write('#speed', str(SPEED) + Keys.ENTER)


def test_layers_and_curves_are_those_that_are_ticked(herding: Herding, page: ConsolePage) -> None:
    layers = 'const {channels, trails, names} = LIVE.shown; return [channels, trails, names]'
    assert page.run(layers) == [[0, 1, 2], True, True]
    for box in ('#channels label:nth-child(2) input', '#trails', '#names'):
        page.click(box)
    assert page.run(layers) == [[0, 2], False, False]
    for box in ('#channels label:nth-child(2) input', '#trails', '#names'):
        page.click(box)
    assert page.run(layers) == [[0, 1, 2], True, True]
    heads = "return [...document.querySelectorAll('#curves h2')].map((h) => h.firstChild.data)"
    page.until(lambda: page.run(heads) != [], 'there are curves')
    curves = page.run(heads)
    page.click('#more summary')
    box = page.click('#choice input:checked')
    page.until(lambda: page.run(heads) == curves[1:], 'one curve less')
    box.click()
    page.until(lambda: page.run(heads) == curves, 'as before')
    page.click('#more summary')


def test_keys_drive_a_shepherd_in_both_frames(herding: Herding, page: ConsolePage) -> None:
    page.take(0)
    until(lambda: herding.driven[0] == 'console', 'the page drives')
    herding.until_moved(0, 0.0, 0.0)
    for keys, (x, y) in [
        (('w',), (0.0, SPEED)), ((Keys.LEFT,), (-SPEED, 0.0)),
        (('s', 'd'), (SPEED / 2**0.5, -SPEED / 2**0.5)), ((Keys.SHIFT, 'd'), (0.4 * SPEED, 0.0)),
    ]:  # fmt: skip
        for key in keys:
            page.hold(key)
        herding.until_moved(0, x, y)
        for key in keys:
            page.let_go(key)
        herding.until_moved(0, 0.0, 0.0)
    page.choose('#frame', 'shepherd')
    page.sent()
    page.run('document.activeElement.blur()')
    page.hold('a')  # to the left of where it looks
    until(lambda: np.hypot(*herding.velocity(0)) > 0.99 * SPEED, 'it moves')
    page.let_go('a')
    drives = [c for c in page.sent() if c['do'] == 'drive']
    assert (0, SPEED, 'body') in {(c['x'], c['y'], c['frame']) for c in drives}
    page.choose('#frame', 'world')
    page.run('document.activeElement.blur()')
    assert herding.driven[1] == 'strombom'  # the other one never noticed
    page.press(Keys.ESCAPE)
    until(lambda: herding.driven[0] == 'strombom', 'it is given back')


def test_the_dead_mans_switch_stops_the_shepherd_while_the_key_is_held(
    herding: Herding, page: ConsolePage
) -> None:
    page.click('#guarded')
    page.take(0)
    page.hold('w')
    page.hold(' ')
    herding.until_moved(0, 0.0, SPEED)
    page.let_go(' ')
    herding.until_moved(0, 0.0, 0.0)
    assert page.run('return [DRIVE.held, DRIVE.keys.has("KeyW")]') == [0, True]
    button = page.find('#guard').rect
    x, y = button['x'] + button['width'] / 2, button['y'] + button['height'] / 2
    page.touch('touchStart', [{'x': x, 'y': y, 'id': 1}])
    herding.until_moved(0, 0.0, SPEED)
    page.touch('touchCancel', [])
    herding.until_moved(0, 0.0, 0.0)
    page.let_go('w')
    page.click('#guarded')


def test_the_stick_drives_while_another_finger_moves_the_plane(
    herding: Herding, page: ConsolePage
) -> None:
    page.click('[aria-label="Zoom out"]')  # from here on the view stays as it is
    page.take(1)
    box = page.find('#stick').rect
    x, y = box['x'] + box['width'] / 2, box['y'] + box['height'] / 2
    touch = [{'x': x, 'y': y, 'id': 1}, {'x': 70, 'y': 150, 'id': 2}]
    page.touch('touchStart', touch[:1])
    page.touch('touchMove', [{**touch[0], 'x': x + 60}])
    herding.until_moved(1, SPEED, 0.0)
    zoom, before = page.zoom(), page.pixel(np.zeros(2))
    page.touch('touchStart', [{**touch[0], 'x': x + 60}, touch[1]])
    page.touch('touchMove', [{**touch[0], 'x': x + 60}, {**touch[1], 'x': 110}])
    page.until(lambda: page.pixel(np.zeros(2)) != before, 'the plane moves')
    assert_allclose(np.subtract(page.pixel(np.zeros(2)), before), [40, 0], atol=1)
    assert page.zoom() == zoom
    herding.until_moved(1, SPEED, 0.0)
    page.touch('touchEnd', [])
    herding.until_moved(1, 0.0, 0.0)
    page.click('[aria-label="Fit all in view"]')


def event(kind: str, target: str = 'window') -> str:
    return f"{target}.dispatchEvent(new Event('{kind}'))"


@pytest.mark.parametrize(
    ('cause', 'given_back'),
    [
        (event('blur'), True),
        (event('pagehide'), True),
        (event('freeze', 'document'), True),
        ("Object.defineProperty(document, 'hidden', {value: true, configurable: true}); "
         + event('visibilitychange', 'document') + '; delete document.hidden', True),
        (event('contextmenu'), False),
        ("dispatchEvent(new KeyboardEvent('keyup', {key: 'Meta'}))", False),
        ("dispatchEvent(new KeyboardEvent('keydown', {key: 'a', ctrlKey: true}))", False),
        ("find('seed').focus()", False),
    ],
)  # fmt: skip
def test_what_takes_the_keys_away_stops_the_shepherd_at_once(
    herding: Herding, page: ConsolePage, cause: str, given_back: bool
) -> None:
    page.take(0)
    page.hold('w')
    herding.until_moved(0, 0.0, SPEED)
    first = page.said_by(cause)[0]
    page.let_go('w')
    if given_back:
        assert first['do'] == 'blur'
        assert 'given back' in page.alert()
        until(lambda: herding.driven[0] == 'strombom' or herding.velocity(0) == (0, 0), 'zero')
    else:
        assert (first['do'], first['x'], first['y']) == ('drive', 0, 0)
        herding.until_moved(0, 0.0, 0.0)
        assert page.run('return DRIVE.held') == 0
        page.press(Keys.ESCAPE)
    page.run('document.activeElement.blur()')


# ---- recordings ----


@pytest.mark.timeout(400)
def test_a_recording_is_made_listed_replayed_and_driven_on_by_another(
    herding: Herding, page: ConsolePage
) -> None:
    page.tab('bags')
    page.click('#record')
    page.until_text('#record', lambda text: text.startswith('Stop'))
    herding.set_steps(120)  # the other future is as long
    page.tab('team')
    page.take(0)
    page.hold('d')
    herding.until_moved(0, SPEED, 0.0)
    herding.until_steps(5)
    page.let_go('d')
    page.press(Keys.ESCAPE)
    herding.until_steps(3)
    page.tab('bags')
    page.click('#record')
    page.until(lambda: len(page.texts('#list li b')) == 1, 'it is listed')
    (name,) = page.texts('#list li b')
    bag = herding.bags / name
    drivers = {
        json.loads(decode_string(message.data))['drivers'][0]
        for message in open_bag(bag).messages()
        if message.topic == '/drivers'
    }
    assert drivers >= {'strombom', 'console'}
    *_, episode = iter_episodes(open_bag(bag))  # the first one was under way

    page.choose('#list li select', f'episode {episode.number}')
    page.click('#list li button')
    page.until(lambda: page.find('#player').is_displayed(), 'it is on the plane', JOB)
    middle = len(episode.frames) // 2
    page.go(middle)
    frame = episode.frames[middle]
    for drawn, places in zip(page.painted(), (frame.sheep, frame.shepherds), strict=True):
        assert_allclose(drawn, places, atol=0.001)
    page.choose('#replay-speed', '25×')
    page.click('#replay-play')
    page.until(lambda: page.step() > middle, 'it plays')
    page.until(lambda: page.run('return !bags.playing'), 'it ends')

    page.go(3)
    page.choose('#rival', 'drover')
    page.click('#whatif button')
    page.until(lambda: page.run('return bags.tracks.length') == 2, 'another future', JOB)
    page.run('bags.play(false)')
    assert page.texts('#futures thead th')[1:] == ['recorded', 'drover']
    page.go(len(episode.frames) - 1)
    own_part, other = page.run(
        'const m = PLANE.moment; return [m.shepherds, m.other.shepherds].map((p) => [...p])'
    )
    assert_allclose(np.reshape(own_part, (-1, 2)), episode.frames[-1].shepherds, atol=0.001)
    assert np.abs(np.subtract(own_part, other)).max() > 0.1
    page.click('#live')
    assert not page.find('#player').is_displayed()
    shown = page.run('return LIVE.frame.number')
    page.until(lambda: page.run('return LIVE.frame.number') > shown, 'it is live again')
    page.click('#refresh')
    assert 'list_bags' in [command['do'] for command in page.sent()]
    herding.set_steps(100_000)


@pytest.mark.timeout(400)
def test_the_value_map_is_shown_when_asked_for(herding: Herding, page: ConsolePage) -> None:
    assert page.run('return PLANE.moment.map') is None
    page.click('#valued')
    page.until(lambda: page.run('return Boolean(PLANE.moment.map)'), 'there is a map', JOB)
    assert 'critic' in page.text('#map-text')
    page.click('#valued')
    page.until(lambda: not page.run('return Boolean(PLANE.moment.map)'), 'it is gone')


# ---- the link ----


def test_it_connects_again_by_itself(herding: Herding, page: ConsolePage) -> None:
    page.take(0)
    page.hold('w')
    page.run(
        'window.SEEN = []; const link = find("link");'
        'new MutationObserver(() => SEEN.push(link.textContent)).observe(link, {childList: true});'
        'LINK.socket.close()'
    )
    page.until(lambda: 'Reconnecting' in page.run('return SEEN'), 'it tries again')
    until(lambda: herding.driven[0] == 'strombom', 'the shepherd is given back')
    page.let_go('w')
    page.until_text('#link', lambda text: text == 'Live')
    before = page.run('return LIVE.frames')
    page.until(lambda: page.run('return LIVE.frames') > before + 2, 'states come again')
    assert page.run('return DRIVE.held') == -1


def test_a_page_from_the_background_gets_the_newest_frame_and_no_burst(
    herding: Herding, page: ConsolePage
) -> None:
    own = page.driver.current_window_handle
    page.driver.switch_to.new_window('tab')
    herding.until_steps(10)
    page.driver.close()
    behind = herding.track.last
    page.driver.switch_to.window(own)
    drawn = page.run(
        'const seen = []; const draw = LINK.draw;'
        'LINK.draw = (frame) => { seen.push(frame.time); draw(frame); }; return window.SEEN = seen'
    )
    page.until(lambda: page.stamp() >= behind, 'a newer state is drawn')
    drawn = page.run('return SEEN.filter((time) => time < arguments[0])', behind / 1e9 - 0.1)
    assert len(drawn) <= 2  # those that were under way


def test_nodes_of_the_page_stay_as_many_as_they_are(herding: Herding, page: ConsolePage) -> None:
    def nodes() -> int:
        page.driver.execute_cdp_cmd('HeapProfiler.collectGarbage', {})
        return page.driver.execute_cdp_cmd('Memory.getDOMCounters', {})['nodes']

    def episode() -> None:
        before = herding.episode.number
        page.click('#reset')
        until(lambda: herding.episode.number > before, 'another episode')
        page.until(lambda: page.run('return LIVE.frame.step') > 5, 'it is drawn')

    episode()
    before = nodes()
    for _ in range(4):
        episode()
    page.until(lambda: nodes() <= before + 10, f'{before} nodes')


# ---- everybody ----


@pytest.mark.parametrize(('width', 'dark'), [(1280, False), (390, True)])
def test_everybody_can_use_it(herding: Herding, page: ConsolePage, width: int, dark: bool) -> None:
    with page.window(width, dark):
        page.run("find('driving').hidden = find('stick').hidden = false")
        for tab in TABS if width < 900 else set(TABS) - {'metrics'}:
            page.tab(tab)
            assert page.findings() == []
            assert page.run('return document.documentElement.scrollWidth') == width
            small = page.run(SMALL)
            assert width > 900 or small == []
    page.run("find('driving').hidden = find('stick').hidden = true")


def test_tabs_and_plane_obey_keys_alone(herding: Herding, page: ConsolePage) -> None:
    page.run("find('tab-team').focus()")
    page.press(Keys.RIGHT)
    assert page.find('#world').is_displayed()
    page.press(Keys.END)
    assert page.find('#nodes').is_displayed()
    page.press(Keys.HOME)
    assert page.find('#team').is_displayed()
    page.run("find('plane').focus()")
    zoom = page.zoom()
    page.press('+')
    assert page.zoom() == pytest.approx(1.3 * zoom)
    page.press('0')
    page.click('#fold')
    assert not page.find('#side').is_displayed()
    page.click('#fold')
