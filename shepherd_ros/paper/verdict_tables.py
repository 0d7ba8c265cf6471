"""Tables of verdicts in Markdown: counts, numbers of a figure, and policies side by side."""

from __future__ import annotations

from collections.abc import Sequence
import math

from shepherd_ros.experiments.methods import label
from shepherd_ros.experiments.table import interval_text
from shepherd_ros.paper.claims import (
    AGREES,
    BETTER,
    Clause,
    ClauseFinding,
    DISAGREES,
    UNDECIDED,
    VERDICTS,
)
from shepherd_ros.paper.judging import Judged
from shepherd_ros.paper.verdicts import counts, Verdict

TITLES = {
    'fig3': 'Figure 3: training',
    'fig4': 'Figure 4: size of the flock',
    'fig5': 'Figure 5: number of shepherds',
    'fractions': 'Text: share of the flock that reaches the goal',
    'fig6': 'Figure 6: noise on observed positions',
    'fig7': 'Figure 7: repulsion between sheep',
    'fig8': 'Figure 8: Reynolds flock',
    'fig9': 'Figure 9: value of a third shepherd',
}

VERDICT_COLUMNS = (
    'the paper states', 'verdict', 'number', 'ours', 'agrees if', 'verdict', 'by bounds alone',
    'until home',
)  # fmt: skip

# of several statements
PLURALS = {
    AGREES: 'agree',
    BETTER: 'better',
    DISAGREES: 'disagree',
    UNDECIDED: 'undecided',
}


def counts_in_words(outcomes: Sequence[Verdict]) -> str:
    """Return how many statements have each verdict, as text."""
    found = counts(outcomes)
    return ', '.join(
        f'{count} {PLURALS[kind] if count > 1 else kind}' for kind, count in found.items() if count
    )


def counts_by_figure(outcomes: Sequence[Verdict]) -> list[str]:
    """Return the table of the number of statements with each verdict, by figure."""
    lines = [f'| | {" | ".join(VERDICTS)} |', '|---|' + '--:|' * len(VERDICTS)]
    for name, title in TITLES.items():
        found = counts([outcome for outcome in outcomes if outcome.experiment == name])
        if any(found.values()):
            lines.append(f'| [{title}]({name}.md) | {" | ".join(map(str, found.values()))} |')
    total = counts(outcomes).values()
    return [*lines, f'| **all** | {" | ".join(f"**{count}**" for count in total)} |']


def counts_by_preset(judged: Sequence[Judged]) -> list[str]:
    """Return the table of the number of statements with each verdict, by preset."""
    lines = [
        f'| preset | {" | ".join(VERDICTS)} | baselines alone |',
        '|---|' + '--:|' * (len(VERDICTS) + 1),
    ]
    for each in judged:
        alone = each.about_baselines
        cells = ' | '.join(str(count) for count in each.counts.values())
        lines.append(
            f'| `{each.preset}` | {cells} | {alone["agrees"] + alone["better"]} of '
            f'{sum(alone.values())} agree |'
        )
    return lines


def bounds(clause: Clause) -> str:
    """Return the bounds of a clause as text, '' without bounds."""
    if math.isinf(clause.low) and math.isinf(clause.high):
        return ''
    return f'{clause.bounds}{f" (better {clause.better})" if clause.better else ""}'


def finding_text(finding: ClauseFinding) -> str:
    """Return our number with its interval, or the reason without one."""
    if math.isnan(finding.value):
        return finding.reason
    text = interval_text(finding.value, finding.low, finding.high)
    return f'{text}; {finding.reason}' if finding.reason else text


def number_table(
    outcomes: Sequence[Verdict], columns: Sequence[str] = VERDICT_COLUMNS
) -> list[str]:
    """Return the table of the numbers of statements, as many columns of it as have a title."""
    marks = ('---', '---', '---', '--:', '--:', '---', '---', '---')[: len(columns)]
    lines = [f'| {" | ".join(columns)} |', f'|{"|".join(marks)}|']
    for outcome in outcomes:
        pairs = zip(outcome.findings, outcome.until_completion, strict=True)
        for k, (finding, other) in enumerate(pairs):
            first = (outcome.statement, f'**{outcome.verdict}**') if k == 0 else ('', '')
            until = f'{finding_text(other)}, {other.verdict}' if other else ''
            cells = [*first, finding.clause.text, finding_text(finding), bounds(finding.clause)]
            cells += [finding.verdict, finding.strict, until]
            lines.append(f'| {" | ".join(cells[: len(columns)])} |')
    return lines


def policy_table(judged: Sequence[Judged], experiment: str) -> list[str]:
    """
    Return the table of the statements of an experiment with a column for each who stands for RL.

    First the primary policy in each preset, then the variants in the first preset.
    """
    columns: dict[str, dict[str, str]] = {}
    for each in judged:
        own = {o.statement: o.verdict for o in each.of(experiment) if o.primary}
        columns[f'primary, `{each.preset}`'] = own
    for outcome in judged[0].of(experiment):
        if not outcome.primary:
            columns.setdefault(label(outcome.policy), {})[outcome.statement] = outcome.verdict
    first = next(iter(columns.values()))
    lines = [f'| | {" | ".join(columns)} |', '|---|' + '---|' * len(columns)]
    for statement, verdict in first.items():
        # without RL, a variant changes nothing
        cells = [own.get(statement, '') for own in columns.values()]
        lines.append(f'| {statement} | **{verdict}** | {" | ".join(cells[1:])} |')
    return lines
