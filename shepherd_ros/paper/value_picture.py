"""Picture of value maps (figure 9)."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
import numpy as np
from shepherd_ros.experiments.methods import label
from shepherd_ros.experiments.value_map import HALF_SIDE, PATCH, places, ValueMap
from shepherd_ros.paper.drawing import label_contours, MAP, new_figure, tidy

COLUMNS = 2
MAX_INTERVALS = 5  # between contours
TEXT = 9  # [pt]
EDGE = {'color': 'white', 'markeredgecolor': 'black', 'linestyle': 'none'}


def draw_values(maps: dict[str, ValueMap]) -> Figure:
    """Return the value of a third shepherd's place by policy (figure 9); brighter is better."""
    columns = min(COLUMNS, len(maps))
    figure, panels = new_figure(-(-len(maps) // columns), columns, 3.1, 2.7)
    for axes in panels.flat[len(maps) :]:
        axes.remove()
    for (name, critic), axes in zip(maps.items(), panels.flat, strict=False):
        extent = (-HALF_SIDE, HALF_SIDE, -HALF_SIDE, HALF_SIDE)
        picture = axes.imshow(critic.values, origin='lower', extent=extent, cmap=MAP)
        tidy(axes, 'x [m]', 'y [m]', label(name))
        axes.label_outer()
        axes.grid(visible=False)
        bar = figure.colorbar(picture, ax=axes, shrink=0.8)
        bar.set_label("critic's value [1]", fontsize=TEXT)
        bar.ax.tick_params(labelsize=TEXT - 1)
        bar.ax.hlines(_contours(axes, critic), *bar.ax.get_xlim(), colors='white')
        _bodies(axes, critic)
    figure.suptitle(
        f'Figure 9: value of a third shepherd\n(n = 1 start; contours and star: means over\n'
        f'{PATCH} x {PATCH} places, the star is at the best)',
        fontsize=10,
    )
    return figure


def _contours(axes: Axes, critic: ValueMap) -> list[float]:
    """Draw contours of the means of patches, with their values; return these."""
    patches, middle = critic.patches, places()[PATCH // 2 : -(PATCH // 2)]
    ticks = MaxNLocator(MAX_INTERVALS, steps=[1, 2, 5, 10]).tick_values(
        patches.min(), patches.max()
    )
    levels = [float(tick) for tick in ticks if patches.min() < tick < patches.max()]
    if levels:
        lines = axes.contour(middle, middle, patches, levels, colors='white', linewidths=1.0)
        label_contours(axes, lines, TEXT - 1)
    return levels


def _bodies(axes: Axes, critic: ValueMap) -> None:
    """Draw goal, sheep, two shepherds and the best place."""
    axes.add_patch(Circle((0, 0), critic.goal_radius, fill=False, color='white', linewidth=2))
    axes.plot(*critic.sheep.T, marker='o', markersize=5, **EDGE)
    reversed_edge = EDGE | {'color': 'black', 'markeredgecolor': 'white'}
    axes.plot(*critic.shepherds.T, marker='^', markersize=9, **reversed_edge)
    axes.plot(*critic.best, marker='*', markersize=14, zorder=5, **EDGE)
    below = {'ha': 'center', 'va': 'center', 'fontsize': TEXT, 'color': 'white', 'zorder': 6}
    halo = [withStroke(linewidth=2, foreground='black')]
    for text, points, distance in (
        ('goal', np.zeros((1, 2)), critic.goal_radius + 2.5),
        ('sheep', critic.sheep, 3.5),
        ('two shepherds', critic.shepherds, 4.0),
    ):
        axes.text(*(points.mean(axis=0) - (0, distance)), text, path_effects=halo, **below)
