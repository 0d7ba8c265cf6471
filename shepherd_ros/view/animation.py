"""An episode as a GIF or a video: flock, shepherds, goal and the rays of one lidar."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import zip_longest
from pathlib import Path

from matplotlib.artist import Artist
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
import numpy as np
from shepherd_ros.config import ConfigError
from shepherd_ros.sim.lidar_layout import channel_of
from shepherd_ros.view.scene import (
    BADGE,
    GOAL_COLOR,
    goal_disc,
    GOAL_FILL,
    INK,
    legend,
    line,
    make_scene,
    SHEEP_COLOR,
    sheep_size,
    shepherd_color,
)
from shepherd_ros.view.track import _Array, EpisodeTrack
from shepherd_ros.view.video import video_writer

RAY = {'linewidths': 0.45, 'alpha': 0.45}
TRAIL = 20  # steps that a shepherd's trail goes back
# colours of the rays of each channel, and of the points where they end


def animate(
    track: EpisodeTrack,
    path: Path | str,
    *,
    max_frames: int = 200,
    fps: float = 20,
    first: int = 0,
    end: float | None = None,
    speed: float | None = None,
    beside: Sequence[EpisodeTrack] = (),
    on_frame: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """
    Write an episode as .gif or .mp4, with others beside it in the same scale.

    At most max_frames of its steps are shown, evenly spread from the first one on, fps per second
    of playing time; one that ends earlier rests. With an end [s] nothing later is shown; with a
    speed so many seconds pass in one, at no more frames per second than there are steps.
    on_frame(done, total) is called after each frame.
    """
    if max_frames < 1:
        raise ConfigError(f'max_frames is {max_frames}: expected at least 1')
    tracks = (track, *beside)
    times = max((t.times for t in tracks), key=len)
    rest = len(times) - first
    if end is not None:
        rest = int((times <= end + 1e-9).sum()) - first
        if rest < 2:
            raise ConfigError(f'end is {end}: expected more than {times[first]:g} s')
    if speed is not None:
        if not speed > 0:
            raise ConfigError(f'speed is {speed}: expected a value above 0, such as 10')
        lasts = max((times[first + rest - 1] - times[first]) / speed, 1 / fps)
        max_frames = max(min(rest, round(fps * lasts)), 1)
        fps = max_frames / lasts
    write = video_writer(Path(path), fps)
    steps = [first + step for step in frame_steps(rest, max_frames)]
    painters = [Painter(t, tracks) for t in tracks]

    def paint(step: int) -> np.ndarray:
        shown = [painter.paint(min(step, len(painter.track.times) - 1)) for painter in painters]
        return np.concatenate(shown, axis=1)

    def frames() -> Iterator[np.ndarray]:
        for done, step in enumerate(steps, start=1):
            yield paint(step)
            on_frame(done, len(steps))

    samples = [paint(first + step) for step in frame_steps(rest, 8)]
    write(frames(), samples)


def frame_steps(n_steps: int, max_frames: int) -> list[int]:
    """Return the steps to show, evenly spread, with the first and the last if there is room."""
    return np.linspace(0, n_steps - 1, min(n_steps, max_frames)).round().astype(int).tolist()


def ray_segments(origin: _Array, ranges: _Array) -> _Array:
    """Return the lines from origin (2,) m to where rays (R,) m end, (K, 2, 2) m; not free rays."""
    angle = 2 * np.pi * np.arange(len(ranges)) / len(ranges)
    hit = np.isfinite(ranges)
    offset = np.stack([np.cos(angle[hit]), np.sin(angle[hit])], axis=-1) * ranges[hit, None]
    return np.stack([np.broadcast_to(origin, offset.shape), origin + offset], axis=1)


def trail_segments(positions: _Array) -> _Array:
    """Return the lines from each of the positions (K, H, 2) m to the next, ((K - 1) H, 2, 2) m."""
    return np.stack([positions[:-1], positions[1:]], axis=2).reshape(-1, 2, 2)


class Painter:
    """Paints any step of a track on one canvas: what never moves is drawn once."""

    def __init__(self, track: EpisodeTrack, beside: Sequence[EpisodeTrack] = ()) -> None:
        """Make the artists and paint the background, large enough for the tracks beside it."""
        self.track = track
        self.figure, axes = make_scene(track, beside=beside)
        self.moving: list[Artist] = []

        def add(artist: Artist) -> Artist:
            self.moving.append(artist)
            artist.set_animated(True)
            return artist

        team = range(track.shepherds.shape[1])
        self.goal = add(axes.add_patch(goal_disc(track.goal[0], track.goal_radius)))
        channels = [channel_of(name) for name in track.channels]
        self.rays = [
            add(axes.add_collection(LineCollection([], colors=c.color, **RAY))) for c in channels
        ]
        self.hits = [
            add(axes.plot([], [], 's', ms=1.6, mfc=c.hit, mew=0, antialiased=False)[0])
            for c in channels
        ]
        self.trails = add(axes.add_collection(LineCollection([], linewidths=2.2)))
        size = sheep_size(track.sheep.shape[1])
        (self.sheep,) = axes.plot(
            [], [], 'o', ms=size, mfc=SHEEP_COLOR, mec='white', mew=0.1 * size
        )
        add(self.sheep)
        self.shepherds, self.numbers = [], []
        for h in team:
            disc = {'ms': 12, 'mfc': shepherd_color(h), 'mec': 'white', 'mew': 1.2}
            self.shepherds.append(add(axes.plot([], [], 'o', **disc)[0]))
            self.numbers.append(add(axes.text(0, 0, str(h), **BADGE)))
        self.status = add(line(self.figure, 50, fontsize=9.5, color=INK))
        fade = np.linspace(0, 0.8, TRAIL + 1)[1:]
        self.fade = np.array([[(*to_rgba(shepherd_color(h))[:3], a) for h in team] for a in fade])
        legend(self.figure, self._legend(), columns=3)
        self.figure.canvas.draw()
        self.background = self.figure.canvas.copy_from_bbox(self.figure.bbox)

    def paint(self, step: int) -> np.ndarray:
        """Return the picture of a step, (height, width, 3) uint8."""
        self._move(step)
        canvas = self.figure.canvas
        canvas.restore_region(self.background)
        for artist in self.moving:
            self.figure.draw_artist(artist)
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()

    def _move(self, step: int) -> None:
        """Put every artist where its data are at a step."""
        track = self.track
        self.goal.set_center(track.goal[step])
        if track.ranges is not None:
            origin = track.shepherds[step, track.lidar_shepherd]
            for rays, hits, ranges in zip(self.rays, self.hits, track.ranges[step], strict=True):
                segments = ray_segments(origin, ranges)
                rays.set_segments(segments)
                hits.set_data(*segments[:, 1].T)
        recent = track.shepherds[max(0, step - TRAIL) : step + 1]
        self.trails.set_segments(trail_segments(recent))
        self.trails.set_color(self.fade[TRAIL + 1 - len(recent) :].reshape(-1, 4))
        self.sheep.set_data(*track.sheep[step].T)
        for shepherd, number, place in zip(
            self.shepherds, self.numbers, track.shepherds[step], strict=True
        ):
            shepherd.set_data(place[:1], place[1:])
            number.set_position(place)
        self.status.set_text(status(track, step))

    def _legend(self) -> list[Line2D]:
        """Return the handles of the legend, column by column."""
        track, (many, one, disc) = self.track, self.track.words
        dot = {'marker': 'o', 'linestyle': 'none', 'markeredgecolor': 'white'}
        handles = [
            Line2D([], [], ms=6, mfc=SHEEP_COLOR, label=many, **dot),
            Line2D([], [], ms=10, mfc=shepherd_color(0), label=one, **dot),
            Line2D(
                [], [], ms=10, mfc=GOAL_FILL, label=disc, **dot | {'markeredgecolor': GOAL_COLOR}
            ),
        ]
        if track.ranges is None:
            return handles
        rays = [
            Line2D(
                [],
                [],
                color=channel_of(name).color,
                linewidth=1.6,
                label=f'lidar {track.lidar_shepherd}: {name}',
            )
            for name in track.channels
        ]
        return [handle for pair in zip_longest(handles, rays) for handle in pair if handle]


def status(track: EpisodeTrack, step: int) -> str:
    """Return the line over a frame, of the same width at every step; shares are rounded down."""
    width = len(str(len(track.times) - 1))
    clock = max(len(f'{t:.1f}') for t in (track.times[0], track.times[-1]))
    share = 100 * int(track.in_goal[step]) // track.sheep.shape[1]
    share = share if track.herds else track.breaches(step)
    numbers = (f'{step:{width}}', f'{track.times[step]:{clock}.1f}', f'{share:3}')
    padded = [number.replace(' ', '\N{FIGURE SPACE}') for number in numbers]
    last = '{} % of the sheep in the goal' if track.herds else '{} steps with a breach'
    return f'step {{}}    {{}} s    {last}'.format(*padded)
