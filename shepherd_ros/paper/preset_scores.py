"""Scores of presets: the numbers of the paper about the baselines that each agrees with."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from shepherd_ros.paper.preset_search import findings, KnownTables, score_of
from shepherd_ros.paper.verdict_tables import bounds, finding_text
from shepherd_ros.sim.presets import PRESETS


def preset_scores(
    names: Sequence[str],
    episodes: int,
    steps: int = 1000,
    on_preset: Callable[[str], None] = lambda text: None,
) -> str:
    """
    Return a table in Markdown, a row for each number and a column for each preset.

    on_preset(text) is called before each preset, which takes minutes.
    """
    tables: KnownTables = {}
    findings_by_preset = {}
    for k, preset in enumerate([PRESETS[name] for name in names], start=1):
        on_preset(
            f'preset {preset.name}, {k} of {len(names)}: {episodes} episodes a cell, some minutes'
        )
        findings_by_preset[preset.name] = findings(preset, episodes, steps, tables)
    head = [
        'the paper states',
        'number',
        'agrees if',
        *(f'`{name}`' for name in findings_by_preset),
    ]
    lines = [head, ['---', '---', '--:', *('--:' for _ in findings_by_preset)]]
    for key, first in findings_by_preset[names[0]].items():
        text = first.clause.text
        each = [f'{finding_text(f[key])}, {f[key].strict}' for f in findings_by_preset.values()]
        lines.append([key.removesuffix(f': {text}'), text, bounds(first.clause), *each])
    scores = [score_of(f.strict for f in each.values()) for each in findings_by_preset.values()]
    count = len(lines) - 2
    lines.append(['**score**', '', '', *(f'**{score:g} of {count}**' for score in scores)])
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines)
