"""Pages: what a reader sees and does, in Chromium."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import time

import numpy as np
from numpy.testing import assert_allclose
import pytest
from selenium import webdriver
from selenium.webdriver import ActionChains, Keys
from selenium.webdriver.common.actions.wheel_input import ScrollOrigin
from selenium.webdriver.common.by import By
from selenium.webdriver.support.select import Select
from shepherd_ros.sim.lidar_layout import CHANNELS
from shepherd_ros.view.page import write_page
from shepherd_ros.view.scene import GOAL_FILL, SHEEP_COLOR, shepherd_color
from view.browser import chromium, Reader
from view.pages import curves, herding, scans, wandering

pytestmark = [
    pytest.mark.system,
    pytest.mark.xdist_group('browser'),  # one browser for all
]
HITS = [channel.hit for channel in CHANNELS.values()]
LAST = 200  # step
AREA = """
const {left, width} = document.querySelector('.plot').getBoundingClientRect();
return [left + LEFT, width - LEFT - RIGHT];
"""


@pytest.fixture(scope='module')
def driver(tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    """Lend a browser with a profile of its own."""
    driver = chromium(tmp_path_factory.mktemp('profile'))
    yield driver
    driver.quit()


TRACK = herding(LAST + 1)
RANGES = np.full((LAST + 1, 3, 3, 8), np.inf)
RANGES[:, 2, 0, 0] = 1.0  # shepherd 2 sees a sheep along +x, a shepherd along -y,
RANGES[:, 2, 1, 6] = 3.0  # and the goal along -x
RANGES[:, 2, 2, 4] = 2.0
ENDS = np.array([[1.0, 0.0], [0.0, -3.0], [-2.0, 0.0]])  # m, from the shepherd


@pytest.fixture(scope='module')
def opened(driver: webdriver.Chrome, tmp_path_factory: pytest.TempPathFactory) -> Reader:
    """Open the page of an episode, once."""
    path = tmp_path_factory.mktemp('page') / 'page.html'
    write_page(TRACK, curves(TRACK), path, ranges=RANGES)
    reader = Reader(driver)
    reader.open(path)
    return reader


@pytest.fixture
def page(opened: Reader) -> Iterator[Reader]:
    """Lend the page at its start, at rest; nothing may have been wrong afterwards."""
    opened.press(Keys.HOME)
    assert opened.step() == 0
    yield opened
    assert opened.complaints() == []
    assert opened.run("return performance.getEntriesByType('resource').map((e) => e.name)") == []


def test_it_plays_until_paused(page: Reader) -> None:
    play = page.find('#play')
    assert (page.find('#clock').text, play.get_attribute('aria-label')) == ('0.0 s', 'Play')
    play.click()
    assert play.get_attribute('aria-label') == 'Pause'
    page.until(lambda: page.step() > 3, 'time goes on')
    play.click()
    stood = page.step()
    assert page.find('#clock').text == f'{0.5 * stood:.1f} s'
    time.sleep(0.4)
    assert page.step() == stood
    assert play.get_attribute('aria-label') == 'Play'


def test_it_plays_as_fast_as_told_and_rests_at_the_end(page: Reader) -> None:
    Select(page.find('#speed')).select_by_visible_text('50×')
    page.find('#play').click()
    begun = time.monotonic()
    page.until(lambda: page.step() == LAST, 'it is over')
    assert time.monotonic() - begun > 0.9 * TRACK.times[-1] / 50
    page.until(lambda: page.find('#play').get_attribute('aria-label') == 'Play', 'it rests')
    page.find('#play').click()  # once more from the start
    assert page.step() < LAST
    page.press(Keys.HOME)


def test_scrubbing_to_the_end_shows_the_last_state(page: Reader) -> None:
    slider = page.find('#scrub')
    half = slider.size['width'] // 2
    actions = ActionChains(page.driver)
    actions.move_to_element_with_offset(slider, 8 - half, 0).click_and_hold()
    actions.move_by_offset(2 * half - 10, 0).release().perform()
    assert page.step() == LAST
    share = 100 * int(TRACK.in_goal[-1]) // 12
    assert page.find('#count').text == f'step {LAST} of {LAST}, {share} % in the goal'
    for drawn, places in zip(page.painted(), (TRACK.sheep, TRACK.shepherds), strict=True):
        assert_allclose(drawn, places[-1], atol=0.001)


@pytest.mark.parametrize('step', [0, 77, LAST])
def test_all_is_painted_at_its_place(page: Reader, step: int) -> None:
    page.go(step)
    assert page.color(TRACK.sheep[step, 0]) == SHEEP_COLOR
    assert page.color(TRACK.sheep[(step + 100) % LAST, 0]) == ''
    assert page.color(TRACK.shepherds[step, 2], 6) == shepherd_color(2)  # beside its number
    around = TRACK.goal[step] + 3.8 * np.stack([np.cos(range(7)), np.sin(range(7))], axis=-1)
    assert GOAL_FILL in {page.color(place) for place in around}
    assert page.color(np.array([-15.0, -19.0])) == ''


def test_the_lidar_of_one_shepherd_is_shown_and_channels_are_taken_away(page: Reader) -> None:
    ends = TRACK.shepherds[0, 2] + ENDS
    menu = Select(page.find('#whose'))
    assert [o.text for o in menu.options] == ['none', *(f'shepherd {h}' for h in range(3))]
    assert [page.color(end) for end in ends] == ['', '', '']  # the first one is chosen
    menu.select_by_visible_text('shepherd 2')
    assert [page.color(end) for end in ends] == HITS
    boxes = page.driver.find_elements(By.CSS_SELECTOR, '#channels input')
    boxes[1].click()
    assert [page.color(end) for end in ends] == [HITS[0], '', HITS[2]]
    boxes[1].click()
    menu.select_by_visible_text('none')
    assert [page.color(end) for end in ends] == ['', '', '']
    menu.select_by_visible_text('shepherd 0')


def test_the_cursor_of_the_curves_moves_with_time(page: Reader) -> None:
    values = curves(TRACK)
    left, width = page.run(AREA)
    lefts = []
    for step in (0, 100, LAST):
        page.go(step)
        lefts.append([c.rect['x'] for c in page.driver.find_elements(By.CSS_SELECTOR, '.cursor')])
        output = [e.text for e in page.driver.find_elements(By.CSS_SELECTOR, '#panel h2 span')]
        assert_allclose(np.array(output, float), [v[step] for v in values.values()], atol=0.0051)
    assert len(lefts[0]) == 3
    expected = left + width * np.array([0, 0.5, 1])
    assert_allclose(np.array(lefts).T, [expected] * 3, atol=2)


def test_the_curves_lead_to_their_times(page: Reader) -> None:
    left, width = page.run(AREA)
    page.point(left + width / 4, page.find('.cursor').rect['y'] + 20).click().perform()
    assert page.step() == pytest.approx(LAST / 4, abs=2)


def test_keys(page: Reader) -> None:
    for keys, step in [
        ([Keys.ARROW_RIGHT] * 3, 3),
        ([Keys.ARROW_LEFT], 2),
        ([Keys.END, Keys.ARROW_RIGHT], LAST),
        ([Keys.HOME, Keys.ARROW_LEFT], 0),
    ]:
        page.press(*keys)
        assert page.step() == step
    shift = ActionChains(page.driver).key_down(Keys.SHIFT)
    shift.send_keys(Keys.RIGHT).key_up(Keys.SHIFT).perform()
    assert page.step() == 10
    page.press(Keys.HOME)
    page.press(' ')
    page.until(lambda: page.step() > 2, 'it plays')
    page.press(' ')
    stood = page.step()
    time.sleep(0.3)
    assert page.step() == stood
    page.find('#ahead').click()
    assert page.step() == stood + 1
    page.find('#back').click()
    page.press(' ')  # plays, and does not step back once more
    page.until(lambda: page.step() > stood + 1, 'it plays')
    page.press(' ')


def test_what_is_painted_stays_in_place_when_the_plane_is_moved_and_enlarged(page: Reader) -> None:
    place, plane = TRACK.sheep[0, 0], page.find('#plane')
    before, zoom = page.pixel(place), page.zoom()
    ActionChains(page.driver).drag_and_drop_by_offset(plane, 60, 30).perform()
    assert_allclose(np.subtract(page.pixel(place), before), [60, 30], atol=1)
    assert page.color(place) == SHEEP_COLOR
    page.find('[aria-label="Zoom out"]').click()
    assert page.zoom() == pytest.approx(zoom / 1.3)
    assert page.color(place) == SHEEP_COLOR
    wheel = ScrollOrigin.from_viewport(*map(round, page.pixel(place)))
    ActionChains(page.driver).scroll_from_origin(wheel, 0, -200).perform()
    page.until(lambda: page.zoom() > zoom, 'it is enlarged')
    assert_allclose(page.pixel(place), [wheel.x_offset, wheel.y_offset], atol=1)
    page.find('[aria-label="Fit all in view"]').click()
    assert (page.pixel(place), page.zoom()) == (before, zoom)


def test_a_sheep_tells_its_place(page: Reader) -> None:
    tip = page.find('#plane .tip')
    page.point(*page.pixel(np.array([-25.0, 20.0]))).perform()
    assert tip.text == 'sheep 0\n-25.00 m, 20.00 m'
    page.press(Keys.ARROW_RIGHT)  # it goes on its way, and the pointer stays
    assert tip.text == f'sheep 0\n-25.00 m, {TRACK.sheep[1, 0, 1]:.2f} m'
    page.point(*page.pixel(np.array([-15.0, -19.0]))).perform()
    assert not tip.is_displayed()


# ---- sizes ----


@pytest.mark.parametrize(
    ('steps', 'n', 'h', 'rays', 'wide'),
    [(1, 1, 1, 0, 1280), (1, 3, 2, 4, 400), (30, 1000, 20, 64, 400)],
)
def test_odd_sizes_and_small_windows(
    driver: webdriver.Chrome, tmp_path: Path, steps: int, n: int, h: int, rays: int, wide: int
) -> None:
    track, reader = wandering(steps, n, h), Reader(driver)
    metrics = curves(track) if n > 1 else {}
    write_page(track, metrics, tmp_path / 'odd.html', ranges=scans(track, rays) if rays else None)
    size = {'width': wide, 'height': 800, 'deviceScaleFactor': 2, 'mobile': wide < 500}
    driver.execute_cdp_cmd('Emulation.setDeviceMetricsOverride', size)
    try:
        reader.open(tmp_path / 'odd.html')
        assert reader.run('return document.documentElement.scrollWidth') == wide
        assert reader.find('#lidar').is_displayed() == bool(rays)
        assert reader.find('#panel').is_displayed() == bool(metrics)
        assert reader.find('#play').is_enabled() == (steps > 1)
        reader.press(Keys.END)
        assert reader.step() == steps - 1
        last = [track.sheep[-1], track.shepherds[-1]]
        for drawn, places in zip(reader.painted(), last, strict=True):
            assert_allclose(drawn, places, atol=0.001)
        for control in ('#play', '#scrub', '#clock', '#speed'):
            rect = reader.find(control).rect
            assert 0 <= rect['x'] <= rect['x'] + rect['width'] <= wide
        assert reader.complaints() == []
    finally:
        driver.execute_cdp_cmd('Emulation.clearDeviceMetricsOverride', {})


def test_a_page_that_cannot_start_says_so(driver: webdriver.Chrome, tmp_path: Path) -> None:
    path, reader = tmp_path / 'page.html', Reader(driver)
    write_page(wandering(2, 1, 1), {}, path)
    path.write_text(path.read_text(encoding='utf-8').replace('"times": {', '"other": {'))
    driver.get(path.as_uri())
    failure = reader.find('#failure')
    reader.until(failure.is_displayed, 'it complains')
    assert 'could not be started' in failure.text
    assert reader.complaints() != []
