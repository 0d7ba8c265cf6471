"""Pages of results, one for each figure: picture, statements, verdict, cause."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from shepherd_ros.config import ConfigError
from shepherd_ros.experiments.methods import label
from shepherd_ros.experiments.samples import Samples
from shepherd_ros.paper.claims import AGREES
from shepherd_ros.paper.judging import Judged
from shepherd_ros.paper.stopping import CERTAIN
from shepherd_ros.paper.verdict_tables import (
    counts_in_words,
    number_table,
    policy_table,
    TITLES,
)
from shepherd_ros.paper.verdicts import Verdict
import tomllib

Causes = Mapping[str, Mapping[str, str]]  # preset, or `beyond` -> statement, or experiment -> text


def read_causes(path: Path) -> Causes:
    """Return the causes of a file, {} without the file; or raise ConfigError."""
    if not path.exists():
        return {}
    try:
        causes = tomllib.loads(path.read_text(encoding='utf-8'))
    except ValueError as error:
        raise ConfigError(f'{path} is no TOML ({error})') from error
    for name, table in causes.items():
        if not isinstance(table, dict) or not all(isinstance(v, str) for v in table.values()):
            raise ConfigError(f'{name} of {path} is {table!r}: expected lines statement = "cause"')
    return causes


def picture(name: str, title: str, pictures: Sequence[str]) -> list[str]:
    """Return the lines of a picture, or of a note without one."""
    if name not in pictures:
        return ['No picture: nothing to draw.', '']
    return [f'![{title}]({name}.png)', '']


def figure_page(
    name: str, judged: Sequence[Judged], pictures: Sequence[str], causes: Causes
) -> str:
    """Return the page of a figure in Markdown; the first preset is the one reported."""
    first, *others = judged
    own = [outcome for outcome in first.of(name) if outcome.primary]
    policies = list(dict.fromkeys(o.policy for o in own if o.policy))
    who = ' and '.join(label(word) for policy in policies for word in policy.split(' and '))
    lines = [
        f'# {TITLES[name]}',
        '',
        *picture(name, TITLES[name], pictures),
        '## Statements',
        '',
        f'Preset `{first.preset}`{episodes_text(first.samples.get(name))}; '
        f'RL is {who or "nobody"}.',
        '',
        *number_table(own),
        '',
        '## Verdict',
        '',
        f'Of {len(own)} statements: {counts_in_words(own)}. Each policy is judged alone.',
        '',
        *policy_table(judged, name),
        '',
    ]
    for each in others:
        also = [outcome for outcome in each.of(name) if outcome.primary]
        numbers = number_table(also)
        if each.preset in causes:
            numbers += ['', *cause_table(also, causes[each.preset])]
        lines += folded(f'Numbers in preset `{each.preset}`', numbers)
    for policy in dict.fromkeys(o.policy for o in first.of(name) if not o.primary):
        also = [outcome for outcome in first.of(name) if outcome.policy == policy]
        lines += folded(f'Numbers with {label(policy)}', number_table(also))
    lines += ['## Cause', '', *cause_table(own, causes.get(first.preset, {}))]
    return '\n'.join(lines).rstrip() + '\n'


def cause_table(outcomes: Sequence[Verdict], causes: Mapping[str, str]) -> list[str]:
    """Return the table of the causes why statements do not agree."""
    rows = [
        f'| {o.statement} | {o.verdict} | {causes.get(o.statement, "not followed up")} |'
        for o in outcomes
        if o.verdict != AGREES
    ]
    head = ['| statement | verdict | cause |', '|---|---|---|']
    return [*head, *rows] if rows else ['All agree.']


def episodes_text(samples: Samples | None) -> str:
    """Return the number, length and seeds of the episodes, '' without rows."""
    if samples is None:
        return ''
    seeds = f'{samples.seeds[0]} to {samples.seeds[-1]}'
    count, whole = len(samples.seeds), samples.experiment.episodes
    less = (
        f' (of {whole}: a short form, or ended early as no verdict was undecided by intervals of '
        f'{100 * CERTAIN:g} %)'
    )
    few = less if count < whole else ''
    return f', {count} episodes of {samples.steps} steps a cell{few}, seeds {seeds}'


def folded(title: str, lines: Sequence[str]) -> list[str]:
    """Return lines in a folded block."""
    return [f'<details><summary>{title}</summary>', '', *lines, '', '</details>', '']


def beyond_page(samples: Mapping[str, Samples], pictures: Sequence[str], causes: Causes) -> str:
    """Return the page of the sweeps beyond the paper in Markdown."""
    lines = ['# Beyond the paper', '', 'Numbers with intervals: `summary.csv`.', '']
    for name, found in samples.items():
        if name == 'cells':  # a page of its own
            continue
        title = found.experiment.title
        lines += [f'## {title}', '', *picture(name, title, pictures)]
        if name in causes.get('beyond', {}):
            lines += [causes['beyond'][name], '']
    return '\n'.join(lines).rstrip() + '\n'
