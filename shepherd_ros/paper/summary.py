"""Picture of the policies beside the heuristics of the literature, in the default setting."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from textwrap import fill

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from shepherd_ros.experiments.bootstrap import Array, mean_interval, percentiles, resampled_means
from shepherd_ros.experiments.catalog import BASELINES
from shepherd_ros.experiments.methods import label
from shepherd_ros.experiments.samples import Samples
from shepherd_ros.experiments.setting import canonical_setting, Setting
from shepherd_ros.paper.claims import SHARE_TOLERANCE
from shepherd_ros.paper.drawing import (
    axis_label,
    limit,
    mean_and_bars,
    new_figure,
    style_of,
    tidy,
)
from shepherd_ros.sim.metrics import METRICS
from shepherd_ros.view.scene import FAINT, INK

# of the summary: metric, and whether more of it is better
SUMMARY = (
    ('completion_time', False),
    ('shepherd_path_length', False),
    ('flock_spread', False),
    ('fraction_in_goal', True),
)
ABREAST = 2  # panels beside each other, so that a phone shows the picture in a size to read
WIDEST = 22  # characters of a line below a panel
QUESTION = 'Is the learned policy better?'


def draw_summary(experiments: Iterable[Samples]) -> Figure | None:
    """
    Return the figure of policies and heuristics, two lines for each flock; None without results.

    It is of the default setting. A word compares each policy with the better of the heuristics:
    `same` unless the 95 % interval of the difference, start by start, excludes 0, for fractions
    also values nearer to 0 than SHARE_TOLERANCE.
    """
    blocks: dict[str, tuple[Samples, int]] = {}
    for samples in experiments:
        first = samples.settings[0]
        default = canonical_setting(Setting(preset=first.preset, flock=first.flock))
        if default in samples.settings and {*BASELINES} < {*samples.controllers}:
            blocks.setdefault(first.flock, (samples, samples.settings.index(default)))
    if not blocks:
        return None
    figure, panels = new_figure(len(blocks) * len(SUMMARY) // ABREAST, ABREAST, 2.35, 1.75)
    lines = panels.reshape(len(blocks), len(SUMMARY))
    for (flock, (samples, row)), line in zip(blocks.items(), lines, strict=True):
        _compare(samples, row, line)
        sheep, episodes = samples.settings[row].sheep, len(samples.seeds)
        text = f'{flock} flock of {sheep} (n = {episodes} episodes of {samples.steps} steps)'
        line[0].set_title(text, fontsize=9, loc='left', color=INK, x=-0.6)
    text = f'{QUESTION}\nMean, 95 % interval; grey: the better heuristic'
    figure.suptitle(text, fontsize=10, color=INK)
    return figure


def _compare(samples: Samples, setting: int, line: Sequence[Axes]) -> None:
    """Draw the metrics of the summary in a setting, a panel each."""
    missing = {
        n for n in samples.policies if np.isnan(samples.values[n, 'flock_spread'][setting, 0])
    }
    names = [*(n for n in samples.policies if n not in missing), *BASELINES]
    for k, ((metric, more), axes) in enumerate(zip(SUMMARY, line, strict=True)):
        values = {name: samples.values[name, metric][setting] for name in names}
        best = max(BASELINES, key=lambda name: (1 if more else -1) * values[name].mean())
        mean, low, high = mean_interval(values[best])
        axes.axvspan(float(low), float(high), color='#D5D9DC', linewidth=0)
        axes.axvline(float(mean), color=FAINT, linewidth=0.8)
        for row, name in enumerate(names):
            mean, bars = mean_and_bars(values[name])
            look = style_of(name, names) | {'linestyle': 'none', 'markersize': 6}
            axes.errorbar(mean, row, xerr=bars[:, None], capsize=2.5, clip_on=False, **look)
            if name in BASELINES:
                continue
            margin = SHARE_TOLERANCE if METRICS[metric].unit == '1' else 0.0
            word = compare_samples(values[name], values[best], more, margin)
            style = {'fontsize': 7.5, 'color': INK, 'va': 'center'}
            style['weight'] = 'bold' if word == 'better' else 'normal'
            axes.text(1.03, row, word, transform=axes.get_yaxis_transform(), **style)
        limit(axes, metric, along='x')
        axes.set_xlim(0, axes.get_xlim()[1] * 1.08)
        text = f'{fill(axis_label(metric), WIDEST)}\n{"more" if more else "less"} is better'
        tidy(axes, text, '')
        shown = [label(name).removesuffix(' (ours)') for name in names]
        axes.set_yticks(range(len(names)), [''] * len(names) if k % ABREAST else shown)
        axes.set_ylim(len(names) - 0.5, -0.5)


def compare_samples(own: Array, other: Array, more: bool, margin: float) -> str:
    """Return better, worse, same or '', for the episodes (E,) of two methods, start by start."""
    if len(own) < 2:
        return ''
    low, high = percentiles(resampled_means(own - other if more else other - own))
    return 'better' if low > margin else 'worse' if high < -margin else 'same'
