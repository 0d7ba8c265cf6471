"""Scores of presets: the numbers of the paper about the baselines that each agrees with."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from shepherd_ros.config import ConfigError, unknown_name
from shepherd_ros.paper.claims import ClauseFinding
from shepherd_ros.paper.preset_search import (
    CHOICES,
    findings,
    KnownTables,
    REPORT_SEED,
    score_of,
    SEARCH_SEED,
)
from shepherd_ros.paper.verdict_tables import finding_text
from shepherd_ros.sim.presets import Preset, PRESETS


def named_preset(word: str) -> Preset:
    """Return the preset of NAME or NAME+PATH=VALUE+..., with these choices; or ConfigError."""
    name, *changes = word.split('+')
    preset = PRESETS[name]
    for change in changes:
        path, _, text = change.partition('=')
        if path not in CHOICES:
            raise unknown_name('choice', path, list(CHOICES))
        values = {str(value).lower(): value for value in CHOICES[path]}
        if text.lower() not in values:
            raise ConfigError(f'{path} is {text!r}: expected one of {", ".join(values)}')
        preset = _with_choice(preset, path, values[text.lower()])
    return preset


def _with_choice(preset: Preset, path: str, value: Any) -> Preset:
    """Return a preset with another value of a choice."""
    if path == 'dt':
        return replace(preset, dt=value)
    kind, name, option = path.split('.')
    parts = dict(preset.flock if kind == 'flock' else preset.controllers)
    parts[name] = {**parts.get(name, {}), option: value}
    if kind == 'flock':
        return replace(preset, flock=parts)
    return replace(preset, controllers=parts)


def both_seeds(
    title: str, preset: Preset, episodes: int, steps: int, known: KnownTables
) -> dict[str, dict[str, ClauseFinding]]:
    """Return two columns of a preset: on the seeds of the search, and on those of the report."""
    return {
        f'{title}, seeds from {first}': findings(preset, episodes, steps, known, first)
        for first in (SEARCH_SEED, REPORT_SEED)
    }


def score_table(columns: Mapping[str, Mapping[str, ClauseFinding]]) -> str:
    """Return a table in Markdown, a row for each number."""
    lines = [
        ['the paper states', 'number', 'agrees if', *columns],
        ['---', '---', '--:', *('--:' for _ in columns)],
    ]
    for key, first in next(iter(columns.values())).items():
        text = first.clause.text
        each = [f'{finding_text(f[key])}, {f[key].strict}' for f in columns.values()]
        lines.append([key.removesuffix(f': {text}'), text, first.clause.bounds, *each])
    count = len(lines) - 2
    scores = [score_of(f.strict for f in each.values()) for each in columns.values()]
    lines.append(['**score**', '', '', *(f'**{score:g} of {count}**' for score in scores)])
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines)


def preset_scores(
    names: Sequence[str],
    episodes: int,
    steps: int = 1000,
    on_preset: Callable[[str], None] = lambda text: None,
) -> str:
    """
    Return a table in Markdown, a row for each number and two columns for each preset.

    on_preset(text) is called before each preset, which takes minutes.
    """
    tables: KnownTables = {}
    columns: dict[str, dict[str, ClauseFinding]] = {}
    presets = {name: named_preset(name) for name in names}
    for k, (name, preset) in enumerate(presets.items(), start=1):
        on_preset(f'preset {name}, {k} of {len(names)}: {episodes} episodes a cell, some minutes')
        columns |= both_seeds(f'`{name}`', preset, episodes, steps, tables)
    return score_table(columns)
