"""First page of results, which answers whether the paper reproduces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from shepherd_ros.experiments.methods import checkpoint_hash, how_made, label
from shepherd_ros.experiments.results import Results
from shepherd_ros.experiments.samples import Samples
from shepherd_ros.paper.claims import (
    ABOUT_TOLERANCE,
    AGREES,
    BETTER,
    DISAGREES,
    HIGH_SHARE,
    SHARE_TOLERANCE,
    UNDECIDED,
)
from shepherd_ros.paper.figure_pages import picture
from shepherd_ros.paper.judging import Judged
from shepherd_ros.paper.summary import QUESTION
from shepherd_ros.paper.verdict_tables import (
    counts_by_figure,
    counts_by_preset,
    counts_in_words,
    TITLES,
)

PAPER_STEPS = 1000  # steps of the paper's episodes
MIN_EPISODES = 10  # episodes below which a page is only a trial
RULE = f"""\
**Rule of a verdict.** Each statement is one number or several, each with bounds; they are data
in `shepherd_ros/paper/`, files `size_statements.py` and `world_statements.py`. `About x` means
within {100 * ABOUT_TOLERANCE:.0f} % of x, for shares of the flock within {SHARE_TOLERANCE}. The
interval is the 95 % bootstrap interval of the number, of 2000 draws of episodes; all controllers
have the same starts, so they are drawn together. A number *agrees* if the whole interval lies
within the bounds, *disagrees* if none of it does, and is *undecided* otherwise. One that would
disagree is *better* if it lies on the side of the bounds that the data name as better for the
user: RL's time or path is shorter, its flock tighter, more sheep are home. A number with bounds
on both sides also agrees where the interval crosses only that to the better side. Nothing is
better where RL brings less than {HIGH_SHARE} of the sheep home. The verdict by the bounds alone
stands beside it. A statement disagrees if one of its numbers does; else it is undecided if one
is; else better if one is.

**The same over ROS.** A cell that real nodes drive over topics in lockstep has these metrics to
the last bit, seed for seed, for both heuristics and for a policy: `test/nodes/test_cell.py`, on
small worlds.

**RL** is one policy of this project for each flock, not the authors'; the table below says how
each was trained. Others are variants, each judged alone on the page of its figure. Paths are
counted over the whole episode, as the paper defines them; the last column of the pages counts
them until the center of mass of the flock has crossed the rim of the goal once.
"""


def front_page(
    judged: Sequence[Judged],
    beyond: Mapping[str, Samples],
    pictures: Sequence[str],
    rows: Results,
    command: str,
) -> str:
    """Return the page in Markdown; pictures and pages of figures lie beside it."""
    first = judged[0]
    names = [name for name in rows.distinct('controller') if name.startswith('policy:')]
    lines = [
        '# Does it reproduce?',
        '',
        *picture('verdicts', 'Verdicts on all statements, by preset', pictures),
        *trial(first.samples),
        *ten_lines(first),
        '',
        *counts_by_preset(judged),
        '',
        f'## In preset `{first.preset}`',
        '',
        *counts_by_figure(first.outcomes),
        '',
        '## How it was found',
        '',
        f'Made by `{command}`. {origin(rows)}',
        '',
        RULE.strip(),
        '',
        *policies(names),
        '',
    ]
    if 'summary' in pictures:
        lines += [f'## {QUESTION}', '', *picture('summary', QUESTION, pictures)]
    if beyond:
        lines += ['Sweeps that the paper does not have: [beyond the paper](beyond.md).']
    return '\n'.join(lines).rstrip() + '\n'


def ten_lines(judged: Judged) -> list[str]:
    """Return a line on all statements, one on the baselines, and one on each figure."""
    total, alone = judged.counts, judged.about_baselines
    good = total[AGREES] + total[BETTER]
    lines = [
        f'- In preset `{judged.preset}`, **{good} of {sum(total.values())} statements hold**: '
        f'{total[AGREES]} agree and {total[BETTER]} are better than stated; '
        f'{total[DISAGREES]} disagree, {total[UNDECIDED]} are undecided.',
        f'- Of the {sum(alone.values())} about the baselines alone, '
        f'{alone[AGREES] + alone[BETTER]} hold.',
    ]
    for name, title in TITLES.items():
        own = [outcome for outcome in judged.of(name) if outcome.primary]
        against = '; '.join(f'"{o.statement}"' for o in own if o.verdict == DISAGREES)
        text = f' Not so: {against}.' if against else ''
        lines.append(f'- [{title}]({name}.md): {counts_in_words(own)}.{text}')
    return lines


def origin(rows: Results) -> str:
    """Return the sentence on the origin of the results."""
    code = ', '.join(f'`{c}`' for c in rows.distinct('code') if c) or 'not known'
    versions = ', '.join(rows.distinct('version'))
    return f'{len(rows)} episodes, version {versions}, commit {code} (+: with changes).'


def trial(samples: Mapping[str, Samples]) -> list[str]:
    """Return the lines of a warning if episodes are short or few, else []."""
    short = [s for s in samples.values() if s.steps < PAPER_STEPS]
    few = [s for s in samples.values() if len(s.seeds) < MIN_EPISODES]
    if not short and not few:
        return []
    steps = min(s.steps for s in samples.values())
    episodes = min(len(s.seeds) for s in samples.values())
    return [
        f'> **A trial, not a result.** Episodes of {steps} steps, {episodes} of each cell: the '
        'numbers and verdicts only show that everything runs.',
        '',
    ]


def policies(names: Sequence[str]) -> list[str]:
    """Return a table of the policies with the commands that trained them."""
    lines = ['| policy | trained by | sha256 |', '|---|---|---|']
    lines += [
        f'| {label(name)} | `{how_made(name)}` | `{checkpoint_hash(name)[:12]}` |'
        for name in names
    ]
    return lines if names else ['No policy was evaluated.']
