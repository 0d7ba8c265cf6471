"""Figures of the paper, and of the sweeps beyond it."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
import numpy as np
from shepherd_ros.experiments.bootstrap import Array
from shepherd_ros.experiments.methods import label
from shepherd_ros.experiments.samples import Samples
from shepherd_ros.paper.curves import Curve, smoothed
from shepherd_ros.paper.drawing import (
    axis_label,
    direct_labels,
    label_contours,
    limit,
    MAP,
    mean_and_bars,
    new_figure,
    style_of,
    tidy,
)
from shepherd_ros.sim.metrics import METRICS
from shepherd_ros.sim.tasks import TASKS
from shepherd_ros.view.scene import FAINT, GRID, INK

AXES = {
    'sheep': 'flock size [sheep]',
    'shepherds': 'team size [shepherds]',
    'noise': 'noise on positions [m]',
    'repulsion': 'repulsion rho_a [1]',
}
MAP_LEVELS = (0.5, 0.9)  # of a share, where contours are drawn


def draw(samples: Samples) -> Figure:
    """Return the figure of an experiment."""
    fields = samples.experiment.axes
    if not all(isinstance(x, int | float) for field in fields for x in samples.axis(field)):
        return draw_cases(samples)
    return draw_maps(samples) if len(fields) == 2 else draw_lines(samples)


def _axis_title(samples: Samples) -> str:
    """Return the title of the axis that an experiment varies, in the words of its task."""
    task, field = samples.settings[0].task, samples.experiment.axes[0]
    many, one, _ = TASKS[task].words
    words = {'sheep': many, 'shepherds': f'{one}s'}
    return AXES[field] if task == 'herding' else words.get(field, AXES[field])


def draw_lines(samples: Samples) -> Figure:
    """Return means over an axis with 95 % intervals, a panel for each metric."""
    experiment = samples.experiment
    x = np.array(samples.axis(experiment.axes[0]), np.float64)
    order, count = np.argsort(x), len(experiment.panels)
    figure, panels = new_figure(-(-count // 2), min(count, 2), 5.0, 3.0)
    for k, (metric, axes) in enumerate(zip(experiment.panels, panels.flat, strict=False)):
        ends, looks = {}, {}
        for name in samples.controllers:
            mean, bars = mean_and_bars(samples.values[name, metric][order])
            look = looks[label(name)] = style_of(name, samples.controllers)
            axes.errorbar(x[order], mean, yerr=bars, capsize=2.5, label=label(name), **look)
            last = np.flatnonzero(np.isfinite(mean))[-1]
            ends[label(name)] = (x[order][last], mean[last])
        limit(axes, metric)
        tidy(axes, _axis_title(samples), axis_label(metric), f'({"abcdef"[k]})')
        direct_labels(axes, ends, looks)
    _title(figure, samples)
    return figure


def draw_cases(samples: Samples) -> Figure:
    """Return a row for each setting, a panel for each metric; one alone has its own range."""
    metrics, names = samples.experiment.panels, samples.controllers
    cases = [str(case) for case in samples.axis('case')]
    width = 4.0 if len(metrics) > 1 else 7.0
    figure, panels = new_figure(1, len(metrics), width, 0.8 + 0.4 * len(cases))
    for k, (metric, axes) in enumerate(zip(metrics, panels.flat, strict=True)):
        for j, name in enumerate(names):
            mean, bars = mean_and_bars(samples.values[name, metric])
            place = np.arange(len(cases)) + 0.7 * ((j + 0.5) / len(names) - 0.5)
            look = style_of(name, names) | {'linestyle': 'none'}
            axes.errorbar(mean, place, xerr=bars, capsize=1.5, label=label(name), **look)
        for row in range(0, len(cases), 2):
            axes.axhspan(row - 0.5, row + 0.5, color=GRID, zorder=0)
        tidy(axes, axis_label(metric), '')
        axes.set_yticks(range(len(cases)), cases if k == 0 else [''] * len(cases))
        axes.set_ylim(len(cases) - 0.5, -0.5)
        if len(metrics) > 1:
            limit(axes, metric, along='x')
    _legend(figure, panels.flat[0])
    _title(figure, samples)
    return figure


def draw_maps(samples: Samples) -> Figure:
    """Return means over two axes, a map for each controller; one scale for each unit."""
    down, across = samples.experiment.axes
    y, x = (sorted(set(samples.axis(field))) for field in (down, across))
    metrics, names = samples.experiment.panels, samples.controllers
    columns = -(-len(names) // -(-len(names) // 5))
    lines = -(-len(names) // columns)
    figure, panels = new_figure(lines * len(metrics), columns, 2.3, 1.9)
    for axes in panels.flat:
        axes.set_visible(False)
    scales: dict[str, Normalize] = {}
    axes_by_unit: dict[str, list[Axes]] = {}
    for metric, block in zip(metrics, np.split(panels, len(metrics)), strict=True):
        unit = METRICS[metric].unit
        means = {name: samples.values[name, metric].mean(axis=-1) for name in names}
        top = 1.0 if unit == '1' else max(float(np.nanmax(m)) for m in means.values())
        scale = scales.setdefault(unit, Normalize(0.0, top))
        scale.vmax = max(scale.vmax or 0.0, top)
        for name, axes in zip(names, block.flat, strict=False):
            axes.set_visible(True)
            grid = np.full((len(y), len(x)), np.nan)
            for place, value in enumerate(means[name]):
                setting = samples.settings[place]
                grid[y.index(getattr(setting, down)), x.index(getattr(setting, across))] = value
            _map(
                axes,
                grid,
                scale,
                MAP_LEVELS if unit == '1' else MaxNLocator(5).tick_values(0, top),
            )
            above = f'{axis_label(metric)}\n\n' if axes is block[0, 0] else ''
            tidy(axes, AXES[across], AXES[down], above + label(name))
            axes.label_outer()
            axes.grid(visible=False)
            axes.set_xticks(range(len(x)), [f'{v:g}' for v in x], fontsize=7)
            axes.set_yticks(range(len(y)), [f'{v:g}' for v in y], fontsize=7)
            axes_by_unit.setdefault(unit, []).append(axes)
    for unit, scale in scales.items():
        mappable = ScalarMappable(scale, MAP)
        names_of = ' and '.join(axis_label(m) for m in metrics if METRICS[m].unit == unit)
        bar = figure.colorbar(mappable, ax=axes_by_unit[unit], aspect=40, pad=0.02)
        bar.set_label(names_of, fontsize=8)
        bar.ax.tick_params(labelsize=7)
    _title(figure, samples)
    return figure


def _map(axes: Axes, grid: Array, scale: Normalize, levels: Sequence[float] | Array) -> None:
    """Draw cells of a grid (rows, columns) and labelled contours over them."""
    axes.imshow(grid, cmap=MAP, norm=scale, aspect='auto', origin='lower')
    crossed = [level for level in levels if np.nanmin(grid) < level < np.nanmax(grid)]
    if crossed and min(grid.shape) > 1:
        label_contours(axes, axes.contour(grid, crossed, colors='white', linewidths=1.0), 7)


def draw_curves(curves: Sequence[Curve]) -> Figure:
    """
    Return return over samples of several trainings (figure 3), a running mean of it.

    Other trainings of the same policy are drawn like the first, but thinner.
    """
    figure, panels = new_figure(1, 1, 7.4, 3.4)
    axes, ends, looks = panels[0, 0], {}, {}
    for policy in dict.fromkeys(curve.policy for curve in curves):
        trainings = [curve for curve in curves if curve.policy == policy]
        kind = 'evaluation episodes' if trainings[0].judged else 'mean reward x 1000'
        name = f'{policy} (n = {len(trainings)})\n{kind}'
        look = style_of(f'policy:{policy}', [f'policy:{c.policy}' for c in curves])
        looks[name] = look
        for k, curve in enumerate(trainings):
            style = look if k == 0 else look | {'linewidth': 0.7, 'markersize': 3}
            every = max(len(curve.samples) // 12, 1)
            axes.plot(curve.samples / 1e6, smoothed(curve), markevery=every, **style)
        ends[name] = (trainings[0].samples[-1] / 1e6, smoothed(trainings[0])[-1])
    tidy(axes, 'samples [million]', 'return of an episode [1]')
    axes.set_ylim(top=10.0)
    direct_labels(axes, ends, looks, gap=0.14)
    figure.suptitle(
        'Figure 3: training; n trainings each, the paper trains for 100 million samples',
        fontsize=10,
    )
    return figure


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
    """Set the title of a figure, with the number of episodes."""
    name = samples.experiment.name
    text = f'Figure {name[3:]}: ' if name.startswith('fig') else ''
    maps = len(samples.experiment.axes) == 2 and samples.experiment.axes != ('preset', 'flock')
    figure.suptitle(
        f'{text}{samples.experiment.title} (n = {len(samples.seeds)} episodes of '
        f'{samples.steps} steps each,{" " if figure.get_figwidth() > 8 else chr(10)}mean'
        f'{"" if maps else " and 95 % interval"})',
        fontsize=10,
        color=INK if samples.steps >= 1000 else FAINT,
    )
