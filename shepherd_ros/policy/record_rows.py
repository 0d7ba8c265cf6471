"""Rows of a checkpoint's metadata for a page; missing entries are left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from shepherd_ros.policy.card import metrics_for, printable, PROVENANCE
from shepherd_ros.policy.policy import PolicyConfig
from shepherd_ros.sim.metrics import Metric, shown

Rows = list[tuple[str, str]]  # name and value
_RANGES = {  # title -> options of the task that are its ends
    'sheep': ('sheep_min', 'sheep_max'),
    'shepherds': ('shepherds_min', 'shepherds_max'),
    'goal radius [m]': ('goal_radius_min', 'goal_radius_max'),
    'repulsion rho_a': ('repulsion_min', 'repulsion_max'),
}
_SINGLE = {'flock': 'flock', 'preset': 'preset', 'noise_max': 'noise up to [m]'}


def record_rows(
    config: PolicyConfig, record: Mapping[str, Any], version: str
) -> Iterator[tuple[str, Rows]]:
    """Yield the title and the rows of each part of the page."""
    yield 'What it is', _network(config)
    yield 'What it was trained on', _task(record)
    metrics = shown('eval', metrics_for(config))
    yield 'What training measured, on the starts that it was chosen on', _results(record, metrics)
    yield 'How it was made', _provenance(record, version)


def _network(config: PolicyConfig) -> Rows:
    """Return what the policy sees and does."""
    sees, network, lidar = config.observation, config.network, config.lidar
    return [
        ('lidar', f'{lidar.n_rays} rays up to {lidar.range_max:g} m'),
        ('channels', ', '.join(lidar.layout.channels)),
        ('frames', f'{sees.n_frames}, {sees.frame_interval:g} s apart'),
        ('layout', f'{sees.layout}, first ray toward the {sees.align}'),
        (
            'network',
            f'{network.filters_1} and {network.filters_2} filters, {network.hidden} units'
            + ', a gate that chooses to drive or to hold' * (network.modes == 2),
        ),
        ('decides every', f'{config.decision_interval:g} s'),
    ]


def _task(record: Mapping[str, Any]) -> Rows:
    """Return the worlds of the training."""
    config = record.get('config')
    run = config.get('run') if isinstance(config, Mapping) else None
    task = run.get('task') if isinstance(run, Mapping) else None
    if not isinstance(task, Mapping):
        return []
    rows = [(title, printable(task[key])) for key, title in _SINGLE.items() if key in task]
    for title, (low, high) in _RANGES.items():
        if low in task and high in task:
            ends = printable(task[low]), printable(task[high])
            rows.append((title, ends[0] if ends[0] == ends[1] else ' to '.join(ends)))
    return rows


def _results(record: Mapping[str, Any], metrics: list[Metric]) -> Rows:
    """Return the means of the evaluation by which the checkpoint was chosen."""
    results = record.get('eval')
    if not isinstance(results, Mapping):
        return []
    titles = [*((metric.name, metric.short) for metric in metrics), ('return', 'return')]
    return [
        (title, f'{results[key]:.4g}')
        for key, title in titles
        if isinstance(results.get(key), int | float)
    ]


def _provenance(record: Mapping[str, Any], version: str) -> Rows:
    """Return the last command, and where and when it ran."""
    rows = []
    if commands := [c for c in printable(record.get('command', '')).split(' && ') if c]:
        rows.append(('command', commands[-1]))
        if len(commands) > 1:
            rows.append(('before it', f'{len(commands) - 1} others: `shepherd checkpoint card`'))
    rows += [(title, printable(record[key])) for key, title in PROVENANCE.items() if key in record]
    return [*rows, ('file written by', f'shepherd_ros {printable(version)}')]
