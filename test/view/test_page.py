"""Pages: what is in the file, without a browser."""

from __future__ import annotations

import math
from pathlib import Path
import re
import subprocess
import sys

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.sim.metrics import METRICS
from shepherd_ros.view import page
from shepherd_ros.view.look import beside
from shepherd_ros.view.packing import MAX_CODE, quantum
from shepherd_ros.view.page import write_page
from shepherd_ros.view.scene import (
    GOAL_COLOR,
    GOAL_FILL,
    GRID,
    INK,
    SHEEP_COLOR,
    SHEPHERD_COLORS,
)
from shepherd_ros.view.track import EpisodeTrack
from view.pages import curves, record_of, scans, unpacked, wandering

MEGABYTE = 1e6
UNITS = {'goal_distance': 'm', 'flock_spread': 'm'}


def notes(path: Path) -> str:
    """Return the small print of a page."""
    (found,) = re.findall(r'<p id="notes">(.*?)<span', path.read_text(encoding='utf-8'), re.DOTALL)
    return ' '.join(found.split())


def test_the_data_come_back_to_within_half_of_what_they_are_rounded_to(tmp_path: Path) -> None:
    track, path = wandering(40, 30, 3), tmp_path / 'page.html'
    ranges = scans(track, 64)
    write_page(track, curves(track), path, units=UNITS, ranges=ranges)
    record = record_of(path)
    for name in ('sheep', 'shepherds'):
        off = np.abs(unpacked(record[name]) - getattr(track, name))
        assert off.max() <= 0.5001 * record[name]['step'] <= 0.001
    assert_array_equal(unpacked(record['times']), track.times)
    assert_array_equal(unpacked(record['goal']), track.goal)
    assert_array_equal(unpacked(record['inGoal']), track.in_goal)
    assert_array_equal(unpacked(record['steps']), np.arange(40))
    assert record['goalRadius'] == 4.0
    for output, (name, values) in zip(record['curves'], curves(track).items(), strict=True):
        assert (output['name'], output['unit']) == (name.replace('_', ' '), UNITS.get(name, ''))
        assert_array_equal(unpacked(output), values.astype(np.float32))
    lidar, seen = record['lidar'], unpacked(record['lidar'])
    assert_array_equal(np.isfinite(seen), np.isfinite(ranges))
    hit = np.isfinite(ranges)
    assert np.abs(seen[hit] - ranges[hit]).max() <= 0.5001 * lidar['step'] <= 0.0011
    assert (lidar['of'], lidar['names']) == ([0, 1, 2], ['sheep', 'shepherds', 'goal'])
    assert lidar['pitch'] == pytest.approx(2 * math.pi / 64)
    assert f'Positions are rounded to {record["sheep"]["step"]:g} m.' in notes(path)
    assert f'all 64 rays are shown, ranges are rounded to {lidar["step"]:g} m' in notes(path)


def test_nothing_is_fetched(tmp_path: Path) -> None:
    track, path = wandering(5, 4, 2), tmp_path / 'page.html'
    write_page(track, curves(track), path, ranges=scans(track, 8))
    text = path.read_text(encoding='utf-8')
    fetched = r'https?:|(?:src|href)="(?!data:,")|url\(|@import|\$[a-z]'
    assert re.findall(fetched, text) == []
    assert "default-src 'none'" in text  # the browser refuses whatever would be fetched


@pytest.mark.parametrize('extent', [1e-9, 0.3, 1.0, 65534.0, 65535.0, 123456.0, 5e8])
def test_steps_are_round_and_just_fine_enough(extent: float) -> None:
    step = quantum(extent)
    assert step * MAX_CODE >= extent
    assert step * MAX_CODE <= 2.51 * extent
    assert f'{step:.0e}'[0] in '125'


def test_text_is_text_and_no_part_of_the_page(tmp_path: Path) -> None:
    track, path = wandering(3, 4, 2), tmp_path / 'page.html'
    write_page(track, {'</script><b>': np.zeros(3)}, path, title='<b>&</script>$style')
    text = path.read_text(encoding='utf-8')
    assert '<b>' not in text
    assert text.count('</script>') == 2
    assert text.count('&lt;b&gt;&amp;&lt;/script&gt;$style') == 2
    assert record_of(path)['curves'][0]['name'] == '</script><b>'


def test_titles_and_facts(tmp_path: Path) -> None:
    path = tmp_path / 'page.html'
    for steps, title, shown, facts in (
        (3, None, 'wandering', '4 sheep, 2 shepherds, 2 steps, 1 s'),
        (2, 'mine', 'mine', '4 sheep, 2 shepherds, 1 step, 0.5 s'),
    ):
        write_page(wandering(steps, 4, 2), {}, path, title=title)
        text = path.read_text(encoding='utf-8')
        assert f'<h1>{shown}</h1>' in text
        assert f'<p>{facts}</p>' in text


def test_pages_have_the_colours_of_pictures() -> None:
    day = dict(re.findall(r'^  --([\w-]+): (#\w{6});$', beside('palette.css'), re.MULTILINE))
    night = dict(re.findall(r'^    --([\w-]+): (#\w{6});$', beside('palette.css'), re.MULTILINE))
    same = {'sheep': SHEEP_COLOR, 'goal': GOAL_COLOR, 'goal-fill': GOAL_FILL, 'ink': INK}
    same |= {'grid': GRID} | {f'shepherd-{h}': c for h, c in enumerate(SHEPHERD_COLORS)}
    assert {name: day[name].upper() for name in same} == same
    assert day.keys() == night.keys()


def test_units_are_those_of_the_metrics() -> None:
    assert all(METRICS[name].unit == unit for name, unit in UNITS.items())
    assert METRICS['fraction_in_goal'].unit == '1'  # which is not shown


def test_the_rays_of_a_track_are_shown_where_no_others_are_given(tmp_path: Path) -> None:
    free = wandering(4, 5, 3)
    one = scans(free, 16)[:, 2]
    track = EpisodeTrack(
        free.times, free.sheep, free.shepherds, free.goal, 4.0, ranges=one, lidar_shepherd=2
    )
    write_page(track, {}, tmp_path / 'page.html')
    lidar = record_of(tmp_path / 'page.html')['lidar']
    assert lidar['of'] == [2]
    assert_allclose(unpacked(lidar)[:, 0], one, atol=lidar['step'])
    write_page(free, {}, tmp_path / 'page.html')
    assert record_of(tmp_path / 'page.html')['lidar'] is None


def test_a_value_that_is_missing_stays_missing(tmp_path: Path) -> None:
    values = np.array([1.0, np.nan, 3.0])
    write_page(wandering(3, 1, 1), {'mine': values}, tmp_path / 'page.html')
    output = record_of(tmp_path / 'page.html')['curves'][0]
    assert_array_equal(unpacked(output), values)
    assert output['unit'] == ''


# ---- sizes ----


def test_a_usual_episode_stays_below_9_megabytes_whatever_the_rays(tmp_path: Path) -> None:
    track, path = wandering(1001, 100, 3), tmp_path / 'page.html'
    write_page(track, curves(track), path, ranges=scans(track, 512, free=0.0))
    assert path.stat().st_size < 9 * MEGABYTE
    assert '1 in 2 of the 512 rays are shown' in notes(path)


def test_fewer_rays_are_shown_where_they_take_too_much_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    track, path = wandering(6, 4, 2), tmp_path / 'page.html'
    ranges = scans(track, 60)
    for limit, value in (('MOST_BYTES', 2000), ('MOST_RANGES', 400)):
        with monkeypatch.context() as patch:
            patch.setattr(page, limit, value)
            write_page(track, {}, path, ranges=ranges)
        lidar = record_of(path)['lidar']
        assert limit == 'MOST_RANGES' or len(lidar['data']) <= 2000
        every = round(lidar['pitch'] / (2 * math.pi / 60))
        assert every > 1
        assert f'Lidar: 1 in {every} of the 60 rays are shown' in notes(path)
        assert_allclose(unpacked(lidar), ranges[..., ::every], atol=lidar['step'])


@pytest.mark.parametrize(('limit', 'value'), [('MOST_STEPS', 5), ('MOST_PLACES', 5 * 6 * 2)])
def test_fewer_steps_are_shown_of_a_long_episode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str, value: int
) -> None:
    monkeypatch.setattr(page, limit, value)
    track, path = wandering(12, 4, 2), tmp_path / 'page.html'
    ranges = scans(track, 8)
    write_page(track, curves(track), path, ranges=ranges)
    record, stored = record_of(path), [0, 3, 6, 9, 11]  # the last one is there
    assert_array_equal(unpacked(record['steps']), stored)
    assert_array_equal(unpacked(record['times']), track.times[stored])
    assert_allclose(unpacked(record['sheep']), track.sheep[stored], atol=0.001)
    assert_allclose(unpacked(record['lidar']), ranges[stored], atol=0.01)
    assert unpacked(record['curves'][0]).shape == (5,)
    assert '1 in 3 steps is shown' in notes(path)


# ---- what is refused ----

TRACK = wandering(3, 4, 2)
NAN = np.full((3, 2, 3, 8), np.nan)


@pytest.mark.parametrize(
    ('name', 'metrics', 'ranges', 'message'),
    [
        ('a.png', {}, None, r"a\.png ends in '\.png': expected \.html"),
        ('none/a.html', {}, None, 'the folder .*none is not there; make it first'),
        ('a.html', {'x': np.zeros(2)}, None, r"metrics\['x'\] has shape \(2,\): expected \(3,\)"),
        ('a.html', {'x': [0, 1, np.inf]}, None, r"metrics\['x'\] is inf at step 2: .*put NaN"),
        ('a.html', {}, np.zeros((3, 3, 8)), r'shape \(3, 3, 8\): expected \(3, 2, 3, any\)'),
        ('a.html', {}, np.zeros((3, 2, 3, 0)), r'expected \(3, 2, 3, any\), not empty'),
        ('a.html', {}, NAN, r'ranges has 144 numbers such as nan: .*put \+inf on free rays'),
        ('a.html', {}, np.full(NAN.shape, -1.0), 'such as -1.0: expect'),
    ],
)
def test_unusable_input_is_refused(
    tmp_path: Path, name: str, metrics: dict, ranges: np.ndarray | None, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        write_page(TRACK, metrics, tmp_path / name, ranges=ranges)
    assert list(tmp_path.iterdir()) == []


def test_times_that_stand_still_are_refused(tmp_path: Path) -> None:
    free = wandering(3, 1, 1)
    track = EpisodeTrack(np.array([0.0, 1.0, 1.0]), free.sheep, free.shepherds, free.goal, 4.0)
    with pytest.raises(ConfigError, match=r'times\[2\] is 1\.0 after 1\.0: expected .*increase'):
        write_page(track, {}, tmp_path / 'page.html')


def test_writing_a_page_needs_no_torch() -> None:
    code = "import sys, shepherd_ros.view.page; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, '-c', code], check=False).returncode == 0
