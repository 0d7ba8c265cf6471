"""Results of an experiment as a Markdown table and as CSV: means with 95 % intervals."""

from __future__ import annotations

from collections.abc import Mapping
import csv
from io import StringIO

from shepherd_ros.experiments.bootstrap import mean_interval
from shepherd_ros.experiments.methods import label
from shepherd_ros.experiments.samples import means, Samples
from shepherd_ros.experiments.setting import SETTING_FIELDS
from shepherd_ros.sim.metrics import Metric, shown
from shepherd_ros.sim.tasks import TASKS


def number_text(value: float) -> str:
    """Return a number as text with three digits."""
    return f'{value:.0f}' if 100 <= abs(value) < 1e6 else f'{value:.3g}'


def interval_text(mean: float, low: float, high: float) -> str:
    """Return a mean with its interval as text."""
    return f'{number_text(mean)} [{number_text(low)}, {number_text(high)}]'


def sample_metrics(samples: Samples) -> Mapping[str, Metric]:
    """Return the metrics of the task of an experiment."""
    return TASKS[samples.settings[0].task].metrics


def varying(samples: Samples) -> list[str]:
    """Return the fields that differ between settings of the experiment, `sheep` if none does."""
    names = [n for n in SETTING_FIELDS if len({getattr(s, n) for s in samples.settings}) > 1]
    return names or ['sheep']


def markdown(samples: Samples) -> str:
    """Return a table with a row for each setting and controller."""
    keys, columns = varying(samples), shown('summary', sample_metrics(samples))
    lines = [
        f'| {" | ".join(keys)} | controller | {" | ".join(metric.words for metric in columns)} |',
        '|' + '--:|' * len(keys) + ':--|' + '--:|' * len(columns),
    ]
    for controller, setting, values in means(samples, [metric.name for metric in columns]):
        cells = [str(getattr(setting, key)) for key in keys]
        cells.append(label(controller))
        for metric in columns:
            mean, low, high = (float(x) for x in mean_interval(values[metric.name]))
            cells.append(interval_text(mean, low, high))
        lines.append(f'| {" | ".join(cells)} |')
    return '\n'.join(lines) + '\n'


def grid(samples: Samples, metric: str) -> str:
    """Return a table of one metric: a row for each flock size and controller, teams across."""
    teams = sorted(set(samples.axis('shepherds')))
    cells = {
        (setting.sheep, label(controller), setting.shepherds): interval_text(
            *(float(x) for x in mean_interval(values[metric]))
        )
        for controller, setting, values in means(samples, (metric,))
    }
    rows = dict.fromkeys((sheep, method) for sheep, method, _ in cells)
    lines = [
        f'| sheep | controller | {" | ".join(f"M = {m}" for m in teams)} |',
        '|--:|:--|' + '--:|' * len(teams),
    ]
    for sheep, method in rows:
        texts = [cells.get((sheep, method, m), '') for m in teams]
        lines.append(f'| {sheep} | {method} | {" | ".join(texts)} |')
    return '\n'.join(lines) + '\n'


def grids(samples: Samples) -> str:
    """Return a page with the grid() of each metric."""
    intro = (
        f'# {samples.experiment.title}\n\n{len(samples.seeds)} starts of each cell, '
        f'{samples.steps} steps; means with 95 % bootstrap intervals.\n'
    )
    parts = [
        f'\n## {metric.words.capitalize()}\n\n{grid(samples, metric.name)}'
        for metric in shown('summary', sample_metrics(samples))
    ]
    return intro + ''.join(parts)


def csv_rows(samples: Samples) -> str:
    """Return a line for each setting, controller and metric, without a header."""
    text = StringIO()
    write = csv.writer(text, lineterminator='\n').writerow
    for controller, setting, values in means(samples, tuple(sample_metrics(samples))):
        for name, episodes in values.items():
            ends = [f'{float(x):.6g}' for x in mean_interval(episodes)]
            fields = [getattr(setting, field) for field in SETTING_FIELDS if field != 'steps']
            row = [samples.experiment.name, controller, *fields, samples.steps, len(episodes)]
            write([*row, name, *ends])
    return text.getvalue()


CSV_HEADER = ','.join(
    ['experiment', 'controller', *(f for f in SETTING_FIELDS if f != 'steps'), 'steps', 'episodes',
     'metric', 'mean', 'low', 'high']
) + '\n'  # fmt: skip
