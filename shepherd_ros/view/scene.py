"""Scene of pictures and animations: colours, and axes in metres that hold an episode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.text import Text
import numpy as np
from shepherd_ros.view.track import _Array, EpisodeTrack

# Okabe and Ito's colours, told apart by colour-blind readers
SHEEP_COLOR = '#0072B2'
GOAL_COLOR = '#009E73'
GOAL_FILL = '#D5EFE6'
INK = '#22272B'
FAINT = '#6B747B'
GRID = '#EDEFF1'
SHEPHERD_COLORS = (
    '#D55E00',
    '#B3478B',
    '#E69F00',
    '#5B3A8C',
    '#8A5A2B',
)  # repeated in larger teams
SHEPHERD_MARKERS = 'os^DvPX'  # along their ways, for readers in grey
BADGE = {  # a shepherd's number, in its disc
    'color': 'white',
    'fontsize': 7,
    'weight': 'bold',
    'ha': 'center',
    'va': 'center_baseline',
}

DPI = 100  # pixels per inch at scale 1; a point is 1 / 72 inch
PLOT_AREA = 530  # [px] side of the square that has the area of the plot
LEFT, RIGHT, TOP, BOTTOM = 58, 18, 62, 92  # [px] margins around the plot
ASPECTS = (0.9, 1.7)  # narrowest and widest plot, width / height


def shepherd_color(shepherd: int) -> str:
    """Return the colour of a shepherd."""
    return SHEPHERD_COLORS[shepherd % len(SHEPHERD_COLORS)]


def shepherd_marker(shepherd: int) -> str:
    """Return the marker of a shepherd's way."""
    return SHEPHERD_MARKERS[shepherd % len(SHEPHERD_MARKERS)]


def sheep_size(n_sheep: int) -> float:
    """Return the diameter of a sheep's dot [pt], smaller in larger flocks."""
    return float(np.clip(5.5 * (100 / n_sheep) ** 0.3, 2.0, 8.0))


def view_limits(*tracks: EpisodeTrack) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top [m] of a plane that holds all agents and the goal."""
    points = [
        points
        for t in tracks
        for points in (t.sheep, t.shepherds, t.goal - t.goal_radius, t.goal + t.goal_radius)
    ]
    flat = np.concatenate([p.reshape(-1, 2) for p in points])
    low, high = flat.min(axis=0), flat.max(axis=0)
    middle, size = (low + high) / 2, 1.07 * (high - low)
    width = max(size[0], ASPECTS[0] * size[1])
    height = max(size[1], width / ASPECTS[1])
    half = np.array([width, height]) / 2
    (left, bottom), (right, top) = middle - half, middle + half
    return float(left), float(right), float(bottom), float(top)


def make_scene(
    track: EpisodeTrack, scale: float = 1.0, beside: Sequence[EpisodeTrack] = ()
) -> tuple[Figure, Axes]:
    """
    Return an empty figure with its Agg canvas, and axes in metres; its size in px is even.

    The axes also hold the tracks that are to be seen beside it.
    """
    left, right, bottom, top = view_limits(track, *beside)
    aspect = (right - left) / (top - bottom)
    width, height = PLOT_AREA * aspect**0.5, PLOT_AREA * aspect**-0.5
    full = [2 * round(s / 2) for s in (width + LEFT + RIGHT, height + TOP + BOTTOM)]
    figure = Figure(figsize=(full[0] / DPI, full[1] / DPI), dpi=DPI * scale, facecolor='white')
    FigureCanvasAgg(figure)
    inside = (LEFT, BOTTOM, full[0] - LEFT - RIGHT, full[1] - TOP - BOTTOM)
    axes = figure.add_axes([p / full[i % 2] for i, p in enumerate(inside)])
    axes.set_aspect('equal')
    axes.set(xlim=(left, right), ylim=(bottom, top))
    axes.set_xlabel('x [m]', fontsize=9, color=FAINT, labelpad=2)
    axes.set_ylabel('y [m]', fontsize=9, color=FAINT, labelpad=1)
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(length=0, labelsize=8, labelcolor=FAINT, pad=4)
    for spine in axes.spines.values():
        spine.set(color='#C9CFD3', linewidth=0.8)
    line(figure, 27, fontsize=12.5, weight='bold', color=INK).set_text(track.title)
    return figure, axes


def line(figure: Figure, below: float, **style: object) -> Text:
    """Return a line of text over the plot, with its base that many px below the upper edge."""
    width, height = figure.get_size_inches() * DPI
    return figure.text(LEFT / width, 1 - below / height, '', **style)


def legend(figure: Figure, handles: list[Any], columns: int) -> None:
    """Write the legend under the plot."""
    width, height = figure.get_size_inches() * DPI
    figure.legend(
        handles=handles,
        loc='center',
        bbox_to_anchor=((LEFT + (width - LEFT - RIGHT) / 2) / width, 26 / height),
        ncol=columns,
        fontsize=8.5,
        labelcolor=INK,
        frameon=False,
        handlelength=1.8,
        handletextpad=0.7,
        columnspacing=1.6,
        labelspacing=0.5,
        numpoints=1,
    )


def goal_disc(center: _Array, radius: float, **style: object) -> Circle:
    """Return the goal region as a patch; center (2,) m."""
    style = {
        'facecolor': GOAL_FILL,
        'edgecolor': GOAL_COLOR,
        'linewidth': 1.4,
        'zorder': 1,
    } | style
    return Circle(center, radius, **style)
