"""The model card of a checkpoint: the metadata of its file in Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.metrics import Metric, shown
from shepherd_ros.sim.tasks import TASKS

PROVENANCE = {
    'seed': 'seed', 'wall_time_s': 'wall time [s]', 'machine': 'machine', 'code': 'commit',
    'version': 'version', 'torch': 'torch', 'note': 'note',
}  # fmt: skip
MAX_TEXT_LENGTH = 8000  # characters of one value of the metadata


def card(name: str, policy: Policy, record: Mapping[str, Any]) -> str:
    """Return the card in Markdown, without the entries that a record lacks."""
    config = policy.config
    obs, network = config.observation, config.network
    actor = sum(p.numel() for p in policy.actor.parameters())
    lines = [f'# Checkpoint `{name}`', '', '## How it was made', '']
    commands = printable(record.get('command', 'the checkpoint does not say')).split(' && ')
    lines += ['```bash', *commands, '```', '']
    lines += [
        f'- {title}: {printable(record[key])}'
        for key, title in PROVENANCE.items()
        if key in record
    ]
    progress = record.get('progress')
    if isinstance(progress, Mapping) and isinstance(progress.get('samples'), int):
        lines.append(f'- kept at {progress["samples"]:,} samples of its last run')
    lines += [
        '',
        '## What it is',
        '',
        f'- one lidar of {config.lidar.n_rays} rays, channels '
        f'{", ".join(config.lidar.layout.channels)}, up to '
        f'{config.lidar.range_max:g} m',
        f'- {obs.n_frames} frames, {obs.frame_interval:g} s apart; layout '
        f'{obs.layout}, first ray toward the {obs.align}, ranges in units of '
        f'{obs.unit or config.lidar.range_max:g} m',
        f'- {network.filters_1} and {network.filters_2} filters, {network.hidden} units, '
        f'{network.padding} padding: {actor:,} weights of the actor, as many but a few of the '
        'critic',
        *(['- two modes, drive and hold, and a gate that chooses'] if network.modes == 2 else []),
        f'- decides every {config.decision_interval:g} s, and holds its action between',
        '',
    ]
    lines += _evaluation(record.get('eval'), metrics_for(config))
    lines += trained_for(record.get('config'))
    return '\n'.join(lines).rstrip() + '\n'


def printable(value: object) -> str:
    """Return text from a file without control characters and Markdown syntax."""
    text = str(value)[:MAX_TEXT_LENGTH]
    return (text if text.isprintable() else ascii(text)).replace('`', "'").replace('|', '/')


def metrics_for(config: PolicyConfig) -> Mapping[str, Metric]:
    """Return the metrics of a policy's task."""
    return TASKS[config.task].metrics


def _evaluation(results: Any, metrics: Mapping[str, Metric]) -> list[str]:
    """Return the section of the evaluation by which the checkpoint was chosen."""
    if not isinstance(results, Mapping):
        return []
    head = [
        '## What training measured',
        '',
        'On the starts that it was chosen on, which flatters:',
    ]
    rows = [
        f'| {title} | {results[key]:.4g} |'
        for key, title in [
            *((m.name, m.short) for m in shown('eval', metrics)),
            ('return', 'return'),
        ]
        if isinstance(results.get(key), int | float)
    ]
    return [*head, '', '| | mean |', '|---|--:|', *rows, '']


def flat_items(data: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield names and values of nested data, with dots in nested names."""
    for key, value in data.items():
        if isinstance(value, Mapping):
            yield from ((f'{key}.{name}', inner) for name, inner in flat_items(value))
        else:
            yield str(key), value


def trained_for(config: Any) -> list[str]:
    """Return the lines of the card about the worlds of its training."""
    run = config.get('run') if isinstance(config, Mapping) else None
    task = run.get('task') if isinstance(run, Mapping) else None
    if not isinstance(task, Mapping):
        return []
    rows = [f'| {printable(key)} | {printable(value)} |' for key, value in flat_items(task)]
    return ['## Worlds of its training', '', '| | |', '|---|--:|', *rows, '']
