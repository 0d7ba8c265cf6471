"""The page of results: each statement of the paper beside our number and a verdict."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import groupby
import math

from shepherd_ros.experiments.methods import checkpoint_hash, how_made, label
from shepherd_ros.experiments.results import Results
from shepherd_ros.experiments.samples import Samples
from shepherd_ros.experiments.table import interval_text
from shepherd_ros.paper.claims import (
    ABOUT_TOLERANCE,
    AGREES,
    Clause,
    ClauseFinding,
    combined_verdict,
    DISAGREES,
    SHARE_TOLERANCE,
    UNDECIDED,
)
from shepherd_ros.paper.summary import QUESTION
from shepherd_ros.paper.verdicts import Verdict

VERDICTS = (AGREES, DISAGREES, UNDECIDED)
PAPER_STEPS = 1000  # steps of the paper's episodes
MIN_EPISODES = 50  # episodes below which a page is only a trial
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
RULE = f"""\
**Rule of a verdict.** Each statement is one number or several, each with bounds; they are data
in `shepherd_ros/paper/statements.py`. `About x` means within {100 * ABOUT_TOLERANCE:.0f} % of x,
for shares of the flock within {SHARE_TOLERANCE}. The interval is the 95 % bootstrap interval of
the number, of 2000 draws of episodes; all controllers have the same starts, so they are drawn
together. A number *agrees* if the whole interval lies within the bounds, *disagrees* if none
of it does, and is *undecided* otherwise. A statement agrees if all its numbers do, and
disagrees if one of them does.

**The same over ROS.** A cell that real nodes drive over topics in lockstep has these metrics to
the last bit, seed for seed, for both heuristics and for a policy: `test/nodes/test_cell.py`, on
small worlds.

**RL** is a policy of this project, not the authors': the table below says how each was
trained. Only those that PPO trained with the flock model of the figure, as in the paper, count in
the summary: a statement agrees if it does with each of them, and disagrees if it does with one.
What the statements come to with other policies in their place is folded up below each figure.
Paths are counted over the whole episode, as the paper defines them; the last column counts them
until the flock is home. The paper leaves the time step, the range of repulsion and parts of the
baselines open; these rows use preset
"""


def page(
    outcomes: Sequence[Verdict],
    samples: Mapping[str, Samples],
    pictures: Sequence[str],
    rows: Results,
    command: str,
    reasons: str = '',
) -> str:
    """Return the page in Markdown; pictures, and the file of reasons, lie beside it."""
    presets = ', '.join(f'`{p}`' for p in rows.distinct('preset') if p)
    names = [name for name in rows.distinct('controller') if name.startswith('policy:')]
    lines = [
        '# The experiments of the paper, and what came of them here',
        '',
        *(picture('summary', QUESTION, pictures) if 'summary' in pictures else []),
        f'Made by `{command}`. {origin(rows)}',
        *reference(reasons),
        *trial(samples),
        '',
        f'{RULE.strip()} {presets}.',
        '',
        *policies(names),
        '',
        *verdict_summary(outcomes),
    ]
    for name, title in TITLES.items():
        own = [j for j in outcomes if j.experiment == name]
        if own or name in pictures:
            lines += ['', f'## {title}', '', *picture(name, title, pictures)]
            lines += verdict_tables([j for j in own if j.counts])
            lines += folded(verdict_tables([j for j in own if not j.counts]))
    beyond = [name for name in samples if name not in TITLES]
    if beyond:
        lines += ['', '## Beyond the paper', '', 'Numbers with intervals: `summary.csv`.']
    for name in beyond:
        title = samples[name].experiment.title
        lines += ['', f'### {title}', '', *picture(name, title, pictures)]
    return '\n'.join(lines).rstrip() + '\n'


def origin(rows: Results) -> str:
    """Return the sentence on the origin of the results."""
    code = ', '.join(f'`{c}`' for c in rows.distinct('code') if c) or 'not known'
    versions = ', '.join(rows.distinct('version'))
    return f'{len(rows)} episodes, version {versions}, commit {code} (+: with changes).'


def reference(reasons: str) -> list[str]:
    """Return a line with a link to a file of reasons, [] without one."""
    line = f'Where a number disagrees, [{reasons}]({reasons}) says what may be behind it.'
    return [line] if reasons else []


def trial(samples: Mapping[str, Samples]) -> list[str]:
    """Return the lines of a warning if episodes are short or few, else []."""
    short_experiment = [s for s in samples.values() if s.steps < PAPER_STEPS]
    few = [s for n, s in samples.items() if n in TITLES and len(s.seeds) < MIN_EPISODES]
    if not short_experiment and not few:
        return []
    steps = min(s.steps for s in samples.values())
    episodes = min(len(s.seeds) for s in samples.values())
    return [
        '',
        f'> **A trial, not a result.** Episodes of {steps} steps, {episodes} of each cell: the '
        'numbers and verdicts only show that everything runs.',
    ]


def policies(names: Sequence[str]) -> list[str]:
    """Return a table of the policies with the commands that trained them."""
    lines = ['| policy | trained by | sha256 |', '|---|---|---|']
    lines += [
        f'| {label(name)} | `{how_made(name)}` | `{checkpoint_hash(name)[:12]}` |'
        for name in names
    ]
    return lines if names else ['No policy was evaluated.']


def verdict_summary(outcomes: Sequence[Verdict]) -> list[str]:
    """Return the table of the number of statements with each verdict, by figure."""
    lines = [f'| | {" | ".join(VERDICTS)} |', '|---|--:|--:|--:|']
    total: Counter[str] = Counter()
    for name, title in TITLES.items():
        verdicts: dict[str, list[str]] = {}  # statement -> verdicts, one for each policy
        for outcome in outcomes:
            if outcome.experiment == name and outcome.counts:
                verdicts.setdefault(outcome.statement, []).append(outcome.verdict)
        counts = Counter(map(combined_verdict, verdicts.values()))
        total += counts
        if counts:
            cells = ' | '.join(str(counts[v]) for v in VERDICTS)
            lines.append(f'| {title} | {cells} |')
    return [*lines, f'| **all** | {" | ".join(f"**{total[v]}**" for v in VERDICTS)} |']


def picture(name: str, title: str, pictures: Sequence[str]) -> list[str]:
    """Return the lines of a picture, or of a note without one."""
    if name not in pictures:
        return ['No picture: nothing to draw.', '']
    return [f'![{title}]({name}.png)', '']


def bounds(clause: Clause) -> str:
    """Return the bounds of a clause as text, '' without bounds."""
    return '' if math.isinf(clause.low) and math.isinf(clause.high) else clause.bounds


def finding_text(finding: ClauseFinding) -> str:
    """Return our number with its interval, or the reason without one."""
    if math.isnan(finding.value):
        return finding.reason
    text = interval_text(finding.value, finding.low, finding.high)
    return f'{text}; {finding.reason}' if finding.reason else text


def verdict_tables(outcomes: Sequence[Verdict]) -> list[str]:
    """Return the tables of the verdicts on a figure, one for each policy that stands for RL."""
    lines: list[str] = []
    ordered = sorted(outcomes, key=lambda j: j.policy)
    for policy, group in groupby(ordered, key=lambda j: j.policy):
        name = label(policy) if policy.startswith('policy:') else policy
        if policy:
            lines += [f'RL is {name}:', '']
        lines += [
            '| the paper states | verdict | number | ours | agrees if | verdict | until home |',
            '|---|---|---|--:|--:|---|---|',
        ]
        for outcome in group:
            lines += claim_lines(outcome)
        lines.append('')
    return lines


def folded(lines: list[str]) -> list[str]:
    """Return lines in a folded block, [] without lines."""
    if not lines:
        return []
    head = '<details><summary>Other policies in the place of RL</summary>'
    return [head, '', *lines, '</details>', '']


def claim_lines(outcome: Verdict) -> list[str]:
    """Return a line for each number of a statement."""
    lines = []
    pairs = zip(outcome.findings, outcome.until_completion, strict=True)
    for k, (finding, other) in enumerate(pairs):
        first = (outcome.statement, f'**{outcome.verdict}**') if k == 0 else ('', '')
        until = f'{finding_text(other)}, {other.verdict}' if other else ''
        cells = [*first, finding.clause.text, finding_text(finding), bounds(finding.clause)]
        lines.append(f'| {" | ".join([*cells, finding.verdict, until])} |')
    return lines
