"""Styles, axes and files of figures; methods differ in line style, marker and label."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
import numpy as np
from shepherd_ros.experiments.bootstrap import Array, mean_interval
from shepherd_ros.experiments.methods import kind_of
from shepherd_ros.policy.checkpoint import (
    checkpoint_file,
    read_checkpoint_metadata,
    shipped_checkpoints,
)
from shepherd_ros.sim.metrics import Metric
from shepherd_ros.sim.tasks import TASKS
from shepherd_ros.view.picture import write_small_png
from shepherd_ros.view.scene import FAINT, GRID, INK

MAP = 'cividis'  # grows lighter evenly, for colour-blind readers as well

# colour (of Okabe and Ito), line and marker of policies and others without a style of their own
SPARE_STYLES = [
    (('#000000', '#009E73', '#E69F00', '#56B4E9', '#666666')[k % 5], line, marker)
    for k, (line, marker) in enumerate(
        zip(
            (
                '-', '--', ':', '-.', (0, (6, 1, 1, 1, 1, 1)), (0, (1, 3)), (0, (8, 2)),
                (0, (3, 5)), (0, (5, 2, 1, 2)), (0, (2, 2)), (0, (10, 3)),
            ),
            'ovP*X<p>hd8',
            strict=True,
        )
    )
]  # fmt: skip


@lru_cache
def _shipped_methods() -> tuple[str, ...]:
    """Return the shipped policies by their full names, those that herd first."""

    def order(name: str) -> tuple[bool, str]:
        config, _, _ = read_checkpoint_metadata(checkpoint_file(name))
        return config.task != 'herding', name

    return tuple(f'policy:{name}' for name in sorted(shipped_checkpoints(), key=order))


def style_of(name: str, names: Iterable[str]) -> dict[str, Any]:
    """Return the line style of a method, the same in all pictures if its checkpoint is shipped."""
    known = dict.fromkeys([*_shipped_methods(), *names])
    free = [other for other in known if kind_of(other).style is None]
    color, line, marker = kind_of(name).style or SPARE_STYLES[free.index(name) % len(SPARE_STYLES)]
    return {
        'color': color,
        'linestyle': line,
        'marker': marker,
        'markersize': 5,
        'linewidth': 1.4,
        'markerfacecolor': color if name.startswith('policy') else 'white',
    }


def new_figure(rows: int, columns: int, width: float, height: float) -> tuple[Figure, Any]:
    """Return a figure with panels (rows, columns), each of a width and height [inch]."""
    size = (width * columns, height * rows + 0.5)
    figure = Figure(figsize=size, dpi=110, facecolor='white', layout='constrained')
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as PNG and SVG, the same bytes for the same figure; return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    write_small_png(figure, folder / f'{name}.png')
    with rc_context({'svg.hashsalt': name, 'svg.fonttype': 'none'}):
        figure.savefig(folder / f'{name}.svg', metadata={'Date': None})
    return [folder / f'{name}.png', folder / f'{name}.svg']


def tidy(axes: Axes, x: str, y: str, title: str = '') -> None:
    """Set labels, title and a light frame."""
    axes.set_xlabel(x, color=INK, fontsize=9)
    axes.set_ylabel(y, color=INK, fontsize=9)
    axes.set_title(title, fontsize=9, color=INK, loc='left')
    axes.tick_params(labelsize=8, colors=INK)
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    for side in ('top', 'right'):
        axes.spines[side].set_visible(False)


def label_contours(axes: Axes, lines: ContourSet, size: float) -> None:
    """Write the values of contours on them, [pt] high, so that they are seen on any colour."""
    for artist in (lines, *axes.clabel(lines, fmt='%g', fontsize=size)):
        artist.set_path_effects([withStroke(linewidth=2.0, foreground=INK)])


def direct_labels(
    axes: Axes, ends: Mapping[str, tuple[float, float]], looks: Any, gap: float = 0.085
) -> None:
    """Write names right of the axes, each with its marker and a line to its end (x, y)."""
    names = sorted(ends, key=lambda name: ends[name][1])
    places = axes.transAxes.inverted().transform(
        axes.transData.transform([ends[n] for n in names])
    )
    heights = spaced(places[:, 1], gap)
    for name, place, height in zip(names, places, heights, strict=True):
        across = {'transform': axes.transAxes, 'clip_on': False}
        axes.plot([place[0], 1.05], [place[1], height], color=FAINT, linewidth=0.5, **across)
        axes.plot([1.05, 1.12], [height] * 2, markevery=[1], **looks[name], **across)
        axes.text(1.15, height, name, fontsize=7.5, color=INK, va='center', **across)


def spaced(heights: Array, gap: float) -> Array:
    """Return ascending heights (K,), moved apart to a gap at least, below 1 if there is room."""
    result = np.array(heights)
    for k in range(1, len(result)):
        result[k] = max(result[k], result[k - 1] + gap)
    top = max(1.0, gap * (len(result) - 1))
    for k in reversed(range(len(result))):
        result[k] = min(result[k], top)
        top = result[k] - gap
    return result


def _metric(name: str) -> Metric:
    """Return a metric of any task."""
    return next(kind.metrics[name] for kind in TASKS.values() if name in kind.metrics)


def axis_label(metric: str) -> str:
    """Return the title of a metric with its unit."""
    entry = _metric(metric)
    return entry.title if f'[{entry.unit}]' in entry.title else f'{entry.title} [{entry.unit}]'


def mean_and_bars(values: Array) -> tuple[Array, Array]:
    """Return means of (..., E), and the distances to the ends of their intervals, (2, ...)."""
    mean, low, high = mean_interval(values)
    return mean, np.maximum(np.nan_to_num(np.stack([mean - low, high - mean])), 0)


def limit(axes: Axes, metric: str, along: str = 'y') -> None:
    """Set the limits of an axis: 0 to 1 for fractions, from 0 for others."""
    top = 1.03 if _metric(metric).unit == '1' else None
    getattr(axes, f'set_{along}lim')(0, top)
