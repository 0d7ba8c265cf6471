"""Presets side by side: how many of the paper's numbers about the baselines each agrees with."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from shepherd_ros.paper.preset_search import findings, KnownTables, worth
from shepherd_ros.paper.report import bounds, finding_text
from shepherd_ros.sim.presets import PRESETS


def preset_scores(
    names: Sequence[str],
    episodes: int,
    steps: int = 1000,
    tell: Callable[[str], None] = lambda text: None,
) -> str:
    """
    Return a table in Markdown, a row for each number and a column for each preset.

    tell hears which preset is run, as each takes minutes.
    """
    known: KnownTables = {}
    found = {}
    for k, preset in enumerate([PRESETS[name] for name in names], start=1):
        tell(
            f'preset {preset.name}, {k} of {len(names)}: {episodes} episodes a cell, some minutes'
        )
        found[preset.name] = findings(preset, episodes, steps, known)
    head = ['the paper states', 'number', 'agrees if', *(f'`{name}`' for name in found)]
    lines = [head, ['---', '---', '--:', *('--:' for _ in found)]]
    for key, first in found[names[0]].items():
        text = first.clause.text
        each = [f'{finding_text(f[key])}, {f[key].verdict}' for f in found.values()]
        lines.append([key.removesuffix(f': {text}'), text, bounds(first.clause), *each])
    scores = [worth(f.verdict for f in each.values()) for each in found.values()]
    count = len(lines) - 2
    lines.append(['**score**', '', '', *(f'**{score:g} of {count}**' for score in scores)])
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines)
