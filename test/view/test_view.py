"""Pictures and animations: what the data say is found at its place in the image."""

from __future__ import annotations

from pathlib import Path
import subprocess
import sys

import imageio.v2 as imageio
from matplotlib.colors import to_rgb
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.view.animation import (
    animate,
    frame_steps,
    Painter,
    ray_segments,
    status,
    TRAIL,
    trail_segments,
)
from shepherd_ros.view.picture import (
    draw_tracks,
    draw_ways,
    free_side,
    shade,
    snapshot_steps,
    time_marks,
)
from shepherd_ros.view.scene import GOAL_FILL, make_scene, SHEEP_COLOR, shepherd_color, view_limits
from shepherd_ros.view.track import EpisodeTrack

WHITE = (255, 255, 255)


def rgb(color: str) -> tuple[int, ...]:
    return tuple(round(255 * c) for c in to_rgb(color))


def still(steps: int = 3, **changes: object) -> EpisodeTrack:
    """Return three sheep and two shepherds at rest, most of them in the corners."""
    sheep = np.array([[-10.0, -10.0], [10.0, 10.0], [7.0, 0.8]])
    shepherds = np.array([[-10.0, 10.0], [10.0, -10.0]])
    values = {
        'times': np.arange(steps) * 0.5,
        'sheep': np.tile(sheep, (steps, 1, 1)),
        'shepherds': np.tile(shepherds, (steps, 1, 1)),
        'goal': np.tile([-3.0, 1.0], (steps, 1)),
        'goal_radius': 2.0,
        'title': 'still',
    }
    return EpisodeTrack(**(values | changes))


def wandering(steps: int, n: int, h: int, rays: np.ndarray | None = None) -> EpisodeTrack:
    """Return random ways of n sheep and h shepherds."""
    rng = np.random.default_rng(0)
    sheep, shepherds = (
        rng.normal(0, 5, (1, k, 2)) + rng.normal(0, 0.3, (steps, k, 2)).cumsum(axis=0)
        for k in (n, h)
    )
    times, goal = np.arange(steps) * 0.5, np.zeros((steps, 2))
    return EpisodeTrack(times, sheep, shepherds, goal, 4.0, ranges=rays, lidar_shepherd=h - 1)


def pixel(track: EpisodeTrack, point: tuple[float, float], scale: float = 1) -> tuple[int, int]:
    """Return the column and row of the pixel at a point in metres."""
    figure, axes = make_scene(track, scale)
    x, y = axes.transData.transform(point)
    return int(x), int(figure.bbox.height - y)


def frames(path: Path) -> list[Image.Image]:
    with Image.open(path) as image:
        shown = []
        for index in range(image.n_frames):
            image.seek(index)
            shown.append(image.convert('RGB'))
        return shown


def drawn(track: EpisodeTrack, path: Path, scale: float = 2) -> Image.Image:
    draw_tracks(track, path, scale=scale)
    with Image.open(path) as image:
        assert image.format == 'PNG'
        return image.convert('RGB')


# Pure functions, by hand


def test_rays_lead_from_the_shepherd_to_where_they_end() -> None:
    segments = ray_segments(np.array([1.0, 2.0]), np.array([3.0, np.inf, 2.0, 4.0]))
    ends = [[4.0, 2.0], [-1.0, 2.0], [1.0, -2.0]]  # along +x, -x and -y; +y is free
    assert_allclose(segments[:, 0], [[1.0, 2.0]] * 3)
    assert_allclose(segments[:, 1], ends, atol=1e-12)


def test_free_rays_are_no_lines() -> None:
    assert ray_segments(np.zeros(2), np.full(512, np.inf)).shape == (0, 2, 2)


def test_the_trail_joins_each_position_to_the_next() -> None:
    directions = np.array(
        [[[0.0, 0.0], [5.0, 5.0]], [[1.0, 0.0], [5.0, 6.0]]]
    )  # two steps, two shepherds
    expected = [[[0.0, 0.0], [1.0, 0.0]], [[5.0, 5.0], [5.0, 6.0]]]
    assert_array_equal(trail_segments(directions), expected)
    assert trail_segments(directions[:1]).shape == (0, 2, 2)


@pytest.mark.parametrize(
    ('steps', 'most', 'expected'),
    [(1, 200, [0]), (4, 200, [0, 1, 2, 3]), (9, 3, [0, 4, 8]), (5, 1, [0]), (1001, 2, [0, 1000])],
)
def test_frames_are_spread_evenly(steps: int, most: int, expected: list[int]) -> None:
    assert frame_steps(steps, most) == expected


def test_snapshots_and_marks_of_time() -> None:
    assert snapshot_steps(1) == [0]
    assert snapshot_steps(10) == [0, 3, 6, 9]
    assert time_marks(np.arange(251) * 0.5) == [0, 50, 100, 150, 200, 250]  # each 25 s
    assert time_marks(np.array([3.0])) == [0]


def test_ways_of_shepherds_differ_also_in_grey() -> None:
    track = wandering(100, 2, 7)
    _, axes = make_scene(track)
    draw_ways(axes, track)
    marks = time_marks(track.times)
    looks = []
    for path in track.shepherds.swapaxes(0, 1):
        (line,) = [line for line in axes.lines if np.array_equal(line.get_xydata(), path[marks])]
        looks.append(line.get_marker())
    assert len(set(looks)) == 7


def test_sheep_in_the_goal_are_counted_with_its_rim() -> None:
    sheep = np.array([[[0.0, 2.0], [0.0, 2.1], [0.0, 0.0]], [[9.0, 0.0]] * 3])
    track = still(2, sheep=sheep, goal=np.zeros((2, 2)))
    assert track.in_goal.tolist() == [2, 0]
    assert_allclose(track.center, [[0.0, 4.1 / 3], [9.0, 0.0]])
    expected = 'step 0 0.0 s 66 % of the sheep in the goal'
    assert ' '.join(status(track, 0).split()) == expected


def test_the_status_has_one_width() -> None:
    track = still(1001)
    assert len({len(status(track, step)) for step in (0, 9, 10, 100, 1000)}) == 1


def test_a_time_is_written_where_the_way_is_not() -> None:
    corner = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [2.0, 2.0], [0.0, 2.0]])
    assert_allclose(free_side(corner, 0, 1.5), [0.0, -1.5])  # the way comes back above
    assert_allclose(free_side(np.zeros((1, 2)), 0, 1.0), [0.0, 1.0])  # no way at all


def test_later_sheep_are_darker() -> None:
    brightness = [np.dot(shade(share), (0.30, 0.59, 0.11)) for share in (0, 1 / 3, 2 / 3, 1)]
    assert (np.diff(brightness) < -0.1).all()
    assert_allclose(shade(1.0), to_rgb(SHEEP_COLOR))


# What is drawn


def test_the_picture_shows_goal_and_sheep_at_their_places(tmp_path: Path) -> None:
    track = still()
    image = drawn(track, tmp_path / 'still.png')
    assert image.getpixel(pixel(track, (-3.0, 1.0), 2)) == rgb(GOAL_FILL)
    assert image.getpixel(pixel(track, (-3.0, 3.3), 2)) == WHITE
    for place in track.sheep[0]:
        assert image.getpixel(pixel(track, place, 2)) == rgb(SHEEP_COLOR)


def test_the_picture_shows_where_sheep_and_shepherds_went(tmp_path: Path) -> None:
    still_track = still(31)
    sheep, shepherds = still_track.sheep.copy(), still_track.shepherds.copy()
    sheep[1:, 2] = [7.0, -6.0]  # from step 1 on it is somewhere else
    shepherds[:, 0, 0] = np.linspace(-10, 0, 31)
    track = still(31, sheep=sheep, shepherds=shepherds)
    image = drawn(track, tmp_path / 'moved.png')
    pale = tuple(round(255 * c) for c in shade(0))
    assert image.getpixel(pixel(track, (7.0, 0.8), 2)) == pytest.approx(pale, abs=1)
    assert image.getpixel(pixel(track, (7.0, -6.0), 2)) == rgb(SHEEP_COLOR)
    direction = np.array(image.getpixel(pixel(track, (-4.9, 10.0), 2)))
    color = np.array(rgb(shepherd_color(0)))
    assert np.linalg.norm(direction - color) < 0.6 * np.linalg.norm(np.array(WHITE) - color)


@pytest.mark.parametrize('scale', [1, 2, 1.5])
def test_the_picture_has_the_size_of_the_scene(tmp_path: Path, scale: float) -> None:
    figure, _ = make_scene(still(), scale)
    image = drawn(still(), tmp_path / 'still.png', scale)
    assert_allclose(image.size, figure.bbox.size, atol=1)


def test_a_metre_is_as_long_along_both_axes() -> None:
    for track in (still(), wandering(20, 50, 3)):
        _, axes = make_scene(track)
        origin, along, up = axes.transData.transform([(0, 0), (10, 0), (0, 10)])
        assert (along - origin)[0] == pytest.approx((up - origin)[1], rel=0.01)


@pytest.mark.parametrize('stretch', [(1, 1), (50, 1), (1, 50)])
def test_everything_lies_in_view(stretch: tuple[int, int]) -> None:
    free = wandering(30, 20, 4)
    track = EpisodeTrack(
        free.times, free.sheep * stretch, free.shepherds * stretch, free.goal + 3, 4.0
    )
    left, right, bottom, top = view_limits(track)
    for points in (track.sheep, track.shepherds, track.goal - 4, track.goal + 4):
        assert (points > (left, bottom)).all()
        assert (points < (right, top)).all()
    assert 0.89 < (right - left) / (top - bottom) < 1.71


def test_a_frame_shows_all_at_their_places_and_follows_the_data() -> None:
    first = still(2)
    sheep = first.sheep.copy()
    sheep[1, 2] = [7.0, -6.0]
    track = still(2, sheep=sheep)
    painter = Painter(track)
    before, after, again = (painter.paint(step) for step in (0, 1, 0))
    old, new = (pixel(track, place)[::-1] for place in sheep[:, 2])
    assert tuple(before[old]) == tuple(after[new]) == rgb(SHEEP_COLOR)
    assert tuple(before[new]) == tuple(after[old]) == WHITE
    assert_array_equal(before, again)  # a frame depends on its step alone
    column, row = pixel(track, (-3.0, 1.0))
    assert tuple(before[row, column]) == rgb(GOAL_FILL)
    column, row = pixel(track, (10.0, -10.0))
    assert tuple(before[row + 6, column]) == rgb(shepherd_color(1))  # below its number


def test_a_goal_that_moves_is_drawn_where_it_is() -> None:
    track = still(2, goal=np.array([[-3.0, 1.0], [1.0, -6.0]]))
    painter = Painter(track)
    here, present = (pixel(track, place)[::-1] for place in track.goal)
    assert tuple(painter.paint(0)[here]) == tuple(painter.paint(1)[present]) == rgb(GOAL_FILL)
    assert tuple(painter.paint(0)[present]) == tuple(painter.paint(1)[here]) == WHITE


def test_rays_are_drawn_to_their_ranges_and_no_farther() -> None:
    ranges = np.full((3, 3, 8), np.inf)
    ranges[:, 0, 6] = 5.0  # sheep channel of shepherd 0 at (-10, 10), ray 6: along -y
    ranges[:, 1, 0] = 12.0  # shepherds channel, along +x
    track = still(ranges=ranges)
    bare, painter = Painter(still()), Painter(track)
    lit = (painter.paint(1) != bare.paint(1)).any(axis=-1)
    for point, is_lit in [
        ((-10, 7), True),
        ((-10, 4.5), False),
        ((0, 10), True),
        ((3, 10), False),
    ]:
        column, row = pixel(track, point)
        assert lit[row - 1 : row + 2, column - 1 : column + 2].any() == is_lit
    assert_allclose(painter.rays[0].get_segments(), [[[-10, 10], [-10, 5]]], atol=1e-12)
    assert_allclose(painter.rays[1].get_segments(), [[[-10, 10], [2, 10]]], atol=1e-12)
    assert painter.rays[2].get_segments() == []


def test_rays_belong_to_the_shepherd_that_is_named() -> None:
    painter = Painter(still(ranges=np.full((3, 3, 4), 1.0), lidar_shepherd=1))
    painter.paint(2)
    assert_allclose(np.stack(painter.rays[0].get_segments())[:, 0], [[10.0, -10.0]] * 4)


def test_long_rays_are_cut_at_the_edge_of_the_plot() -> None:
    far, none = np.full((3, 3, 64), 1e4), np.full((3, 3, 64), np.inf)
    changed = Painter(still(ranges=far)).paint(0) != Painter(still(ranges=none)).paint(0)
    rows, columns = changed.any(axis=-1).nonzero()
    left, bottom = pixel(still(), view_limits(still())[::2])
    right, top = pixel(still(), view_limits(still())[1::2])
    assert columns.min() >= left - 1
    assert columns.max() <= right + 1
    assert rows.min() >= top - 1
    assert rows.max() <= bottom + 1
    assert rows.size > 1000


def test_a_trail_is_short_and_fades_backwards() -> None:
    painter = Painter(wandering(3 * TRAIL, 5, 2))
    for step, links in [(0, 0), (3, 3), (2 * TRAIL, TRAIL)]:
        painter.paint(step)
        assert len(painter.trails.get_segments()) == 2 * links
    alphas = painter.trails.get_colors()[::2, 3]
    assert (np.diff(alphas) > 0).all()
    assert_allclose(painter.trails.get_segments()[-1][1], painter.track.shepherds[2 * TRAIL, 1])


# Files


def test_a_gif_has_the_frames_of_the_steps_in_time(tmp_path: Path) -> None:
    walk = still(41).sheep.copy()
    walk[:, 2, 1] = np.linspace(0, -6, 41)
    track, path, seen = still(41, sheep=walk), tmp_path / 'walk.gif', []
    animate(track, path, max_frames=5, fps=10, on_frame=lambda *progress: seen.append(progress))
    figure, _ = make_scene(track)
    shown = frames(path)
    assert len(shown) == 5
    assert seen == [(1, 5), (2, 5), (3, 5), (4, 5), (5, 5)]
    for image, step in zip(shown, [0, 10, 20, 30, 40], strict=True):
        assert image.size == tuple(figure.bbox.size.round().astype(int))
        assert image.getpixel(pixel(track, walk[step, 2])) == pytest.approx(
            rgb(SHEEP_COLOR), abs=8
        )
        assert image.getpixel(pixel(track, (-3.0, 1.0))) == pytest.approx(rgb(GOAL_FILL), abs=8)
        assert image.getpixel((3, 3)) == pytest.approx(WHITE, abs=8)
    with Image.open(path) as image:
        assert image.info['loop'] == 0
        assert image.info['duration'] == 100


INFINITE = np.full((3, 3, 512), np.inf)


@pytest.mark.parametrize(
    'track',
    [
        wandering(1, 1, 1),
        wandering(1, 3, 2, np.full((1, 3, 4), 2.0)),
        wandering(2, 1, 20),
        wandering(3, 1000, 20, np.full((3, 3, 512), 20.0)),
        wandering(3, 100, 3, INFINITE),
    ],
    ids=['one-step', 'one-step-lidar', 'one-sheep', 'crowd', 'nothing-seen'],
)
def test_odd_sizes(tmp_path: Path, track: EpisodeTrack) -> None:
    animate(track, tmp_path / 'odd.gif')
    shown = frames(tmp_path / 'odd.gif')
    assert len(shown) == len(track.times)
    assert all(side % 2 == 0 for side in shown[0].size)  # as videos need it
    image = drawn(track, tmp_path / 'odd.png')
    last = track.shepherds.shape[1] - 1
    column, row = pixel(track, track.shepherds[-1, last], 2)
    assert image.getpixel((column, row + 11)) == rgb(shepherd_color(last))  # on top of all


def test_rays_that_are_all_free_leave_no_trace() -> None:
    seen, none = still(ranges=INFINITE), still(ranges=INFINITE + 0)
    painter = Painter(seen)
    assert_array_equal(painter.paint(0), Painter(none).paint(0))
    assert all(rays.get_segments() == [] for rays in painter.rays)


def test_a_video_has_every_frame_and_shows_what_was_painted(tmp_path: Path) -> None:
    track = still(5)
    animate(track, tmp_path / 'still.mp4', fps=25)
    shown = imageio.mimread(tmp_path / 'still.mp4')
    assert len(shown) == 5
    painted = Painter(track).paint(4)
    assert shown[4].shape == painted.shape
    assert np.abs(shown[4].astype(float) - painted).mean() < 4  # lossy, but the same picture


def test_end_and_speed_decide_how_long_an_animation_lasts(tmp_path: Path) -> None:
    track, path = still(41), tmp_path / 'still.gif'  # 20 s
    seen: list[tuple[int, int]] = []
    for options, frames_shown, duration in (
        ({'speed': 2.0}, 41, 240),  # every step in 10 s
        ({'end': 10.0, 'speed': 10.0}, 20, 50),
        ({'end': 10.0}, 21, 50),
    ):
        animate(track, path, on_frame=lambda *progress: seen.append(progress), **options)
        assert seen[-1] == (frames_shown, frames_shown)
        with Image.open(path) as image:
            assert image.info['duration'] == duration


@pytest.mark.parametrize(
    ('name', 'options', 'message'),
    [
        ('a.avi', {}, r"'\.avi': expected \.gif or \.mp4"),
        ('none/a.gif', {}, 'folder .*none is not there'),
        ('a.gif', {'fps': 0}, r'fps is 0: expected a value in \[1, 50\]'),
        ('a.gif', {'max_frames': 0}, 'max_frames is 0: expected at least 1'),
        ('a.gif', {'end': 0.0}, 'end is 0.0: expected more than 0 s'),
        ('a.gif', {'speed': 0.0}, 'speed is 0.0: expected a value above 0, such as 10'),
    ],
)
def test_unusable_settings_are_refused_at_once(
    tmp_path: Path, name: str, options: dict, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        animate(still(), tmp_path / name, **options)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'sheep': np.zeros((3, 2))}, r'sheep has shape \(3, 2\): expected \(3, any, 2\)'),
        ({'shepherds': np.zeros((3, 0, 2))}, r'shepherds has shape .* not empty'),
        ({'ranges': np.zeros((3, 2, 8))}, r'ranges has shape \(3, 2, 8\): expected \(3, 3, any\)'),
        ({'ranges': np.full((3, 3, 8), np.nan)}, 'ranges has 72 numbers'),
        ({'goal': np.full((3, 2), np.inf)}, 'goal has 6 numbers that are not finite'),
        ({'goal_radius': 0.0}, 'goal_radius is 0.0'),
        ({'lidar_shepherd': 2}, 'lidar_shepherd is 2: expected an index below the 2 shepherds'),
    ],
)
def test_unusable_tracks_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        still(**changes)


def test_no_global_state_of_matplotlib_is_loaded() -> None:
    code = (
        'import sys, shepherd_ros.view.animation, shepherd_ros.view.picture;'
        "sys.exit('matplotlib.pyplot' in sys.modules or 'torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, '-c', code], check=False).returncode == 0
