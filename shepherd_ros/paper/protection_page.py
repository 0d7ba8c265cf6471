"""Page of the results of payload protection, the second chapter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from shepherd_ros.experiments.catalog import ESCORTS
from shepherd_ros.experiments.methods import label
from shepherd_ros.experiments.results import Results
from shepherd_ros.experiments.samples import Samples
from shepherd_ros.experiments.table import markdown
from shepherd_ros.paper.figure_pages import episodes_text, folded, picture
from shepherd_ros.paper.protection_statements import PROTECTION_CLAIMS
from shepherd_ros.paper.report import origin, policies
from shepherd_ros.paper.verdict_tables import counts_in_words, number_table
from shepherd_ros.paper.verdicts import Verdict, verdicts_on_samples

_RULE = """\
The statements are this project's, and the task's numbers are choices: the paper gives none. A
number *agrees* if its whole 95 % bootstrap interval lies within the bounds, *disagrees* if none of
it does, and is *undecided* otherwise; all controllers have the same starts. Clean success is an
arrival of the payload without a pedestrian in its region at any step."""
_COLUMNS = ('statement', 'verdict', 'number', 'measured', 'agrees if', 'verdict')


def protection_verdicts(samples: Mapping[str, Samples]) -> list[Verdict]:
    """Return the verdicts on all statements whose experiments are there."""
    primary = ESCORTS[0]
    found = [
        outcome
        for each in samples.values()
        for outcome in verdicts_on_samples(each, primary, PROTECTION_CLAIMS)
    ]
    return [outcome for outcome in found if outcome.primary]


def protection_page(
    samples: Mapping[str, Samples],
    pictures: Sequence[str],
    causes: Mapping[str, str],
    rows: Results,
    command: str,
) -> str:
    """Return the page in Markdown; causes are texts by experiment, rows those of the task."""
    outcomes = protection_verdicts(samples)
    names = [name for name in rows.distinct('controller') if name.startswith('policy:')]
    lines = [
        '# Payload protection',
        '',
        'Three escorts and forty pedestrians of model `crowd` unless a figure says otherwise; '
        f'{label(ESCORTS[0])} is `RL`. `idle` stands for no escort: its escorts stay where they '
        'start, and the payload leaves them behind.',
        '',
        '## Statements',
        '',
        f'Of {len(outcomes)} statements: {counts_in_words(outcomes)}.',
        '',
        *number_table(outcomes, _COLUMNS),
        '',
        _RULE,
        '',
    ]
    for name, found in samples.items():
        title = found.experiment.title
        lines += [f'## {title}', '', *picture(name, title, pictures)]
        lines += [f'Mean and 95 % interval{episodes_text(found)}.', '']
        if name in causes:
            lines += [causes[name], '']
        lines += folded('Numbers', markdown(found).rstrip().splitlines())
    lines += ['## How it was found', '', f'Made by `{command}`. {origin(rows)}', '']
    return '\n'.join([*lines, *policies(names)]).rstrip() + '\n'
