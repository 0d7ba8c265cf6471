"""An episode as one picture: where the flock was, and the ways of flock and shepherds."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
import numpy as np
from PIL import Image
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
    shepherd_marker,
)
from shepherd_ros.view.track import _Array, EpisodeTrack

SNAPSHOTS = 4  # times at which all sheep are drawn, pale to dark
TIME_MARKS = 6  # times marked on the tracks, about
MIN_LABEL_SPACING = 0.045  # of the plot's width: nearest that two times are written
PARTING = '#F0E442'  # yellow
HALO = [withStroke(linewidth=2.6, foreground='white')]


def draw_tracks(
    track: EpisodeTrack,
    path: Path | str,
    *,
    scale: float = 2.0,
    beside: Sequence[EpisodeTrack] = (),
) -> None:
    """
    Write the picture of an episode, as .png (or .pdf, .svg); at scale 1 it has 100 dpi.

    With others beside it, all in the same scale, it is a .png.
    """
    tracks = (track, *beside)
    figures = [_figure(t, scale, tracks) for t in tracks]
    if len(figures) == 1:
        figures[0].savefig(path)
        return
    for figure in figures:
        figure.canvas.draw()
    rows = [np.asarray(figure.canvas.buffer_rgba())[..., :3] for figure in figures]
    Image.fromarray(np.concatenate(rows, axis=1)).save(path)


def write_small_png(figure: Figure, path: Path) -> None:
    """Write a figure as PNG with a palette of 128 colours."""
    image = BytesIO()
    figure.savefig(image, format='png')
    picture = Image.open(image).convert('RGB')
    small = picture.quantize(128, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    small.save(path, optimize=True)


def _figure(track: EpisodeTrack, scale: float, tracks: Sequence[EpisodeTrack]) -> Figure:
    figure, axes = make_scene(track, scale, tracks)
    steps = snapshot_steps(len(track.times))
    draw_goal(axes, track)
    handles = draw_flock(axes, track, steps)
    handles += draw_ways(axes, track)
    line(figure, 50, fontsize=9.5, color=INK).set_text(summary(track))
    legend(figure, handles, columns=4)
    return figure


def snapshot_steps(n_steps: int) -> list[int]:
    """Return the steps whose sheep are drawn, first and last among them."""
    return sorted(set(np.linspace(0, n_steps - 1, SNAPSHOTS).round().astype(int).tolist()))


def time_marks(times: _Array) -> list[int]:
    """Return the steps nearest to round times within the episode, about MARKS of them."""
    round_times = MaxNLocator(TIME_MARKS, steps=[1, 2, 2.5, 5, 10]).tick_values(
        times[0], times[-1]
    )
    inside = round_times[(round_times >= times[0]) & (round_times <= times[-1])]
    return sorted({int(np.abs(times - t).argmin()) for t in inside})


def shade(share: float) -> tuple[float, float, float]:
    """Return the colour of sheep at a share of the episode: pale at 0, full at 1."""
    strength = 0.28 + 0.72 * share
    red, green, blue = (1 - strength * (1 - c) for c in to_rgb(SHEEP_COLOR))
    return red, green, blue


def draw_goal(axes: Axes, track: EpisodeTrack) -> None:
    """Draw the goal at the end, and dashed where it started if it moved."""
    axes.add_patch(goal_disc(track.goal[-1], track.goal_radius))
    axes.add_patch(goal_disc(track.goal[-1], track.goal_radius, facecolor='none', zorder=2.9))
    if (track.goal[0] != track.goal[-1]).any():
        style = {'facecolor': 'none', 'linestyle': '--', 'linewidth': 1.0}
        axes.add_patch(goal_disc(track.goal[0], track.goal_radius, **style))


def draw_flock(axes: Axes, track: EpisodeTrack, steps: list[int]) -> list[Line2D]:
    """Draw all sheep at some steps, the later over the earlier; return the legend's handles."""
    size, last = sheep_size(track.sheep.shape[1]), len(track.times) - 1
    style: dict[str, Any] = {'marker': 'o', 'linestyle': 'none', 'markeredgecolor': 'white'}
    handles = []
    for order, step in enumerate(steps):
        style |= {
            'mfc': shade(step / last if last else 1.0),
            'label': f'{track.words[0]}, {track.times[step]:.4g} s',
        }
        points = {'ms': 0.85 * size, 'mew': 0.08 * size, 'zorder': 2 + 0.1 * order}
        axes.plot(*track.sheep[step].T, **style, **points)
        handles.append(Line2D([], [], ms=6.5, **style))
    return handles


def draw_ways(axes: Axes, track: EpisodeTrack) -> list[Line2D]:
    """Draw the ways of flock and shepherds with marks of time; return the legend's handles."""
    marks, center = time_marks(track.times), track.middle
    for shepherd, path in enumerate(track.shepherds.swapaxes(0, 1)):
        color, marker = shepherd_color(shepherd), shepherd_marker(shepherd)
        axes.add_collection(faded(path, color))
        axes.plot(*path[marks].T, marker, ms=5.5, mfc=color, mec='white', mew=0.6, zorder=3.5)
        axes.plot(*path[:1].T, marker, ms=6.5, mfc='white', mec=color, mew=1.5, zorder=4)
        top = {'zorder': 10 + 0.01 * shepherd}
        axes.plot(*path[-1:].T, 'o', ms=12, mfc=color, mec='white', mew=1.2, **top)
        axes.text(*path[-1], str(shepherd), **BADGE, **top)
    axes.plot(*center.T, color=INK, linewidth=1.8, zorder=7, path_effects=HALO)
    axes.plot(*center[marks].T, 'o', ms=4, mfc='white', mec=INK, mew=1.2, zorder=8)
    write_times(axes, track, marks)
    if track.parting is not None:
        style: dict[str, Any] = {'marker': 'D', 'ls': 'none', 'mfc': PARTING, 'mec': INK}
        axes.plot(*center[track.parting], ms=8, mew=1.2, zorder=8.5, **style)
    first = {'color': shepherd_color(0), 'marker': 'o', 'linewidth': 1.3}
    (_, one, disc), about = (
        track.words,
        'flock center' if track.herds else f'{track.words[2]}, path',
    )
    return [
        Line2D([], [], color=INK, linewidth=1.8, marker='o', mfc='white', ms=4, label=about),
        Line2D([], [], ms=6, mfc='white', mew=1.5, label=f'{one}, start', **first),
        Line2D([], [], ms=9, mec='white', label=f'{one}, end', **first),
        Line2D([], [], ls='none', marker='o', ms=10, mfc=GOAL_FILL, mec=GOAL_COLOR, label=disc),
    ]


def faded(path: _Array, color: str) -> LineCollection:
    """Return a way (T, 2) m as a line that grows stronger with time."""
    lines = np.stack([path[:-1], path[1:]], axis=1)
    strength = np.linspace(0.3, 0.95, len(lines))
    colors = [(*to_rgb(color), alpha) for alpha in strength]
    return LineCollection(lines, colors=colors, linewidths=1.4, capstyle='butt', zorder=3)


def write_times(axes: Axes, track: EpisodeTrack, marks: list[int]) -> None:
    """Write the time beside marks of the way, none too near to another."""
    left, right = axes.get_xlim()
    near, written = MIN_LABEL_SPACING * (right - left), np.empty((0, 2))
    for step in marks:
        place = free_side(track.middle, step, 0.75 * near)
        if (np.linalg.norm(written - place, axis=1) < near).any():
            continue
        written = np.vstack([written, place])
        style = {'fontsize': 8, 'color': INK, 'zorder': 9, 'path_effects': HALO}
        axes.text(*place, f'{track.times[step]:.4g} s', ha='center', va='center', **style)


def free_side(path: _Array, step: int, distance: float) -> _Array:
    """Return the point at a distance beside a way (T, 2) m, on the side with more room, (2,) m."""
    ahead = path[min(step + 1, len(path) - 1)] - path[max(step - 1, 0)]
    length = np.linalg.norm(ahead)
    across = np.array([-ahead[1], ahead[0]]) / length if length > 0 else np.array([0.0, 1.0])
    sides = path[step] + distance * np.stack([across, -across])  # (2, 2)
    room = np.linalg.norm(sides[:, None] - path, axis=-1).min(axis=1)
    return sides[room.argmax()]


def summary(track: EpisodeTrack) -> str:
    """Return the line over the picture: length of the episode, share in the goal or breaches."""
    steps, share = len(track.times) - 1, 100 * int(track.in_goal[-1]) // track.sheep.shape[1]
    length = f'{steps} steps    {track.times[-1] - track.times[0]:.4g} s'
    if track.herds:
        text, end = f'{length}    {share} % of the sheep in the goal', ' at the end'
    else:
        region, end = f'{track.words[0]} in the region', ''
        text = f'{length}    {region} in {track.breaches(steps)} steps'
    if track.parting is None:
        return f'{text}{end}'
    return f'{text}    \N{BLACK DIAMOND} parting, {track.times[track.parting]:.4g} s'
