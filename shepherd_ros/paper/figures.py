"""Pictures of results, like those of the paper; they can be read in black and white."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
import numpy as np
from shepherd_ros.experiments.bootstrap import mean_interval
from shepherd_ros.experiments.methods import kind_of, label
from shepherd_ros.experiments.samples import Samples
from shepherd_ros.experiments.value_map import SIDE, ValueMap
from shepherd_ros.paper.curves import Curve, smoothed
from shepherd_ros.sim.metrics import METRICS
from shepherd_ros.view.scene import FAINT, GRID, INK

AXES = {
    'sheep': 'sheep',
    'shepherds': 'shepherds',
    'noise': 'noise on positions [m]',
    'repulsion': 'repulsion between sheep, rho_a',
    'preset': 'preset',
    'flock': 'flock',
    'case': '',
}
# colour, line and marker of policies and others without a style of their own: apart in grey, too
SPARE_STYLES = [
    (('#000000', '#555555')[k % 2], ('-', '--', ':')[k % 3], marker)
    for k, marker in enumerate('ovP*<h>pX')
]


def style_of(name: str, names: Sequence[str]) -> dict[str, Any]:
    """Return colour, line and marker of a method; names are those of the picture, in its order."""
    free = [other for other in names if kind_of(other).style is None]
    color, line, marker = kind_of(name).style or SPARE_STYLES[free.index(name) % len(SPARE_STYLES)]
    return {
        'color': color,
        'linestyle': line,
        'marker': marker,
        'markersize': 5,
        'linewidth': 1.4,
        'capsize': 2.5,
        'markerfacecolor': color if name.startswith('policy') else 'white',
    }


def new_figure(rows: int, columns: int, width: float, height: float) -> tuple[Figure, Any]:
    """Return a figure with panels (rows, columns), each so wide and high [inch]."""
    size = (width * columns, height * rows + 0.5)
    figure = Figure(figsize=size, dpi=110, facecolor='white', layout='constrained')
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as PNG and SVG, the same bytes for the same figure; return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f'{name}.png', metadata={'Software': None})
    from matplotlib import rc_context

    with rc_context({'svg.hashsalt': name, 'svg.fonttype': 'none'}):
        figure.savefig(folder / f'{name}.svg', metadata={'Date': None})
    return [folder / f'{name}.png', folder / f'{name}.svg']


def tidy(axes: Axes, x: str, y: str, title: str = '') -> None:
    """Name the axes and make the frame light."""
    axes.set_xlabel(x, color=INK, fontsize=9)
    axes.set_ylabel(y, color=INK, fontsize=9)
    axes.set_title(title, fontsize=10, color=INK, loc='left')
    axes.tick_params(labelsize=8, colors=INK)
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    for side in ('top', 'right'):
        axes.spines[side].set_visible(False)


def draw(samples: Samples) -> Figure:
    """Return the picture of an experiment."""
    kind = samples.experiment.axes
    if len(kind) == 2:
        return draw_maps(samples)
    return draw_cases(samples) if kind == ('case',) else draw_lines(samples)


def draw_lines(samples: Samples) -> Figure:
    """Return means over an axis with 95 % intervals, a panel for each metric."""
    experiment = samples.experiment
    x = np.array(samples.axis(experiment.axes[0]), np.float64)
    order, count = np.argsort(x), len(experiment.panels)
    columns = 2 if count == 4 else count
    figure, panels = new_figure(-(-count // columns), columns, 4.2, 3.0)
    for k, (metric, axes) in enumerate(zip(experiment.panels, panels.flat, strict=False)):
        for name in samples.controllers:
            mean, low, high = mean_interval(samples.values[name, metric][order])
            bars = np.nan_to_num(np.stack([mean - low, high - mean]))
            look = style_of(name, samples.controllers)
            axes.errorbar(x[order], mean, yerr=np.maximum(bars, 0), label=label(name), **look)
        _limit(axes, metric)
        tidy(axes, AXES[experiment.axes[0]], METRICS[metric].title, f'({"abcdef"[k]})')
    _legend(figure, panels.flat[0])
    _title(figure, samples)
    return figure


def draw_cases(samples: Samples) -> Figure:
    """Return a row for each setting, a panel for each metric; one alone has its own range."""
    metrics, names = samples.experiment.panels, samples.controllers
    cases = [str(case) for case in samples.axis('case')]
    width = 4.0 if len(metrics) > 1 else 7.0
    figure, panels = new_figure(1, len(metrics), width, 0.8 + 0.34 * len(cases))
    for k, (metric, axes) in enumerate(zip(metrics, panels.flat, strict=True)):
        for j, name in enumerate(names):
            mean, low, high = mean_interval(samples.values[name, metric])
            bars = np.maximum(np.nan_to_num(np.stack([mean - low, high - mean])), 0)
            place = np.arange(len(cases)) + 0.6 * ((j + 0.5) / len(names) - 0.5)
            look = style_of(name, samples.controllers) | {'linestyle': 'none'}
            axes.errorbar(mean, place, xerr=bars, label=label(name), **look)
        axes.set_yticks(range(len(cases)), cases if k == 0 else [''] * len(cases))
        axes.set_ylim(len(cases) - 0.5, -0.5)
        tidy(axes, METRICS[metric].title, '')
        if len(metrics) > 1:
            _limit(axes, metric, along='x')
    _legend(figure, panels.flat[0])
    _title(figure, samples)
    return figure


def draw_maps(samples: Samples) -> Figure:
    """Return means over two axes, a line of maps for each controller; darker is more."""
    down, across = samples.experiment.axes
    rows = list(dict.fromkeys(samples.axis(down)))
    columns = list(dict.fromkeys(samples.axis(across)))
    metrics, names = samples.experiment.panels, samples.controllers
    width, height = max(1.5 + 0.4 * len(columns), 3.2), 1.1 + 0.2 * len(rows)
    figure, panels = new_figure(len(names), len(metrics), width, height)
    for metric, line in zip(metrics, panels.T, strict=True):
        means = {name: samples.values[name, metric].mean(axis=-1) for name in names}
        top = 1.0 if METRICS[metric].unit == '1' else max(np.nanmax(m) for m in means.values())
        for name, axes in zip(names, line, strict=True):
            grid = np.full((len(rows), len(columns)), np.nan)
            for place, value in enumerate(means[name]):
                setting = samples.settings[place]
                row = rows.index(getattr(setting, down))
                grid[row, columns.index(getattr(setting, across))] = value
            axes.imshow(grid, cmap='Greys', vmin=0, vmax=1.2 * top, aspect='auto', origin='lower')
            for (i, j), value in np.ndenumerate(grid):
                text = '' if np.isnan(value) else f'{value:.2f}' if top <= 1 else f'{value:.0f}'
                color = 'white' if value > 0.6 * top else 'black'
                axes.text(j, i, text, ha='center', va='center', fontsize=7, color=color)
            tidy(axes, AXES[across], AXES[down], f'{label(name)}\n{METRICS[metric].title}')
            axes.title.set_fontsize(7)
            axes.grid(visible=False)
            axes.set_xticks(range(len(columns)), [str(c) for c in columns])
            axes.set_yticks(range(len(rows)), [str(r) for r in rows])
    _title(figure, samples)
    return figure


def draw_curves(curves: Sequence[Curve]) -> Figure:
    """
    Return return over samples of several trainings (figure 3), a running mean of it.

    Other trainings of the same policy are drawn like the first, but thinner.
    """
    figure, panels = new_figure(1, 1, 6.0, 3.2)
    axes = panels[0, 0]
    policies = dict.fromkeys(curve.policy for curve in curves)
    looks = dict(zip(policies, SPARE_STYLES * len(policies), strict=False))
    named: set[str] = set()
    for curve in curves:
        color, line, marker = looks[curve.policy]
        every = max(len(curve.samples) // 12, 1)
        look = {'color': color, 'linestyle': line, 'marker': marker, 'markevery': every}
        if curve.policy in named:  # another training of the same
            axes.plot(curve.samples / 1e6, smoothed(curve), markersize=3, linewidth=0.7, **look)
            continue
        named.add(curve.policy)
        kind = 'judged episodes' if curve.judged else 'mean reward x 1000'
        text = f'{curve.policy} (ours; {kind})'
        axes.plot(curve.samples / 1e6, smoothed(curve), label=text, markersize=4, **look)
    tidy(axes, 'samples [million]', 'return of an episode')
    axes.set_ylim(top=10.0)
    axes.legend(fontsize=8, frameon=False)
    figure.suptitle('Figure 3: training; the paper trains for 100 million samples', fontsize=10)
    return figure


def draw_values(maps: dict[str, ValueMap]) -> Figure:
    """Return the value of a third shepherd's place by policy (figure 9); brighter is better."""
    figure, panels = new_figure(1, len(maps), 4.6, 4.0)
    for (name, found), axes in zip(maps.items(), panels.flat, strict=True):
        extent = (-SIDE, SIDE, -SIDE, SIDE)
        picture = axes.imshow(found.values, origin='lower', extent=extent, cmap='cividis')
        axes.contour(found.values, 8, extent=extent, colors='black', linewidths=0.4)
        axes.add_patch(Circle((0, 0), found.goal_radius, fill=False, color='white', linewidth=2))
        axes.plot(*found.sheep.T, 'o', color='white', markeredgecolor='black', markersize=5)
        axes.plot(*found.shepherds.T, '^', color='black', markeredgecolor='white', markersize=9)
        tidy(axes, 'x [m]', 'y [m]', label(name))
        axes.grid(visible=False)
        figure.colorbar(picture, ax=axes, shrink=0.8, label="critic's value")
    figure.suptitle('Figure 9: value of a third shepherd; white ring: goal', fontsize=10)
    return figure


def _limit(axes: Axes, metric: str, along: str = 'y') -> None:
    """Let shares go from 0 to 1, all others from 0."""
    top = 1.03 if METRICS[metric].unit == '1' else None
    getattr(axes, f'set_{along}lim')(0, top)


def _legend(figure: Figure, axes: Axes) -> None:
    handles, texts = axes.get_legend_handles_labels()
    figure.legend(
        handles,
        texts,
        loc='outside lower center',
        ncols=max(1, min(len(texts), int(figure.get_figwidth() / 2))),
        fontsize=8,
        frameon=False,
        handlelength=3.5,
    )


def _title(figure: Figure, samples: Samples) -> None:
    """Say what is shown, and of how many episodes."""
    name = samples.experiment.name
    text = f'Figure {name[3:]}: ' if name.startswith('fig') else ''
    apart = ' ' if figure.get_figwidth() > 8 else '\n'
    figure.suptitle(
        f'{text}{samples.experiment.title}{apart}'
        f'({len(samples.seeds)} episodes of {samples.steps} steps each, mean'
        f'{" and 95 % interval" if len(samples.experiment.axes) == 1 else ""})',
        fontsize=10,
        color=INK if samples.steps >= 1000 else FAINT,
    )
