"""Criteria of a policy in a cell: against both heuristics, on the same starts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from shepherd_ros.experiments.bootstrap import Array, mean_interval
from shepherd_ros.experiments.catalog import BASELINES
from shepherd_ros.experiments.methods import label
from shepherd_ros.experiments.samples import Samples
from shepherd_ros.experiments.setting import describe_setting, Setting
from shepherd_ros.experiments.table import number_text

TIME_MARGIN = 0.02  # of the faster heuristic's time
PATH_SHARE = 0.5  # of the shorter heuristic's path
LEAST_REACHED, LEAST_IN_GOAL = 0.99, 0.98  # shares of the flock
METRICS_USED = (
    'completion_time', 'shepherd_path_length', 'flock_spread', 'fraction_reached',
    'fraction_in_goal', 'completed',
)  # fmt: skip
CRITERIA = f"""
A policy meets a criterion in a cell if its mean does. Both heuristics have the same starts.

| criterion | met if |
|---|---|
| time | at most {TIME_MARGIN:.0%} longer than that of the faster heuristic; the interval is of the paired difference |
| path | at most {PATH_SHARE:g} of that of the heuristic with the shorter one, whole episode |
| spread | at most that of the heuristic with the smaller one |
| held | {LEAST_REACHED:g} of the flock reach the goal, and {LEAST_IN_GOAL:g} are in it at the end |
| home | the flock comes home in each episode |
"""  # noqa: E501


@dataclass(frozen=True)
class CellComparison:
    """A policy in a cell: its means, and those of the heuristic that is better in each."""

    setting: Setting
    policy: str
    time: float  # [steps]
    time_limit: float  # of the faster heuristic [steps]
    difference: tuple[float, float, float]  # of the times, paired, with its 95 % interval [steps]
    path: float  # [m]
    path_limit: float  # [m]
    spread: float  # [m]
    spread_limit: float  # [m]
    reached: float
    in_goal: float
    away: int  # episodes in which the flock never comes home

    @property
    def met(self) -> dict[str, bool]:
        """Return whether each criterion is met."""
        return {
            'time': self.difference[0] <= TIME_MARGIN * self.time_limit,
            'path': self.path <= self.path_limit,
            'spread': self.spread <= self.spread_limit,
            'held': self.reached >= LEAST_REACHED and self.in_goal >= LEAST_IN_GOAL,
            'home': self.away == 0,
        }

    @property
    def missed(self) -> list[str]:
        """Return the names of the criteria that are not met."""
        return [name for name, met in self.met.items() if not met]


def compare(
    setting: Setting, policy: str, own: Mapping[str, Array], others: Sequence[Mapping[str, Array]]
) -> CellComparison:
    """Return the comparison of a policy's episodes, (E,) a metric, with those of heuristics."""

    def least(name: str) -> float:
        return min(float(other[name].mean()) for other in others)

    faster = min(others, key=lambda other: float(other['completion_time'].mean()))
    mean, low, high = mean_interval(own['completion_time'] - faster['completion_time'])
    means = {name: float(values.mean()) for name, values in own.items()}
    return CellComparison(
        setting,
        policy,
        time=means['completion_time'],
        time_limit=least('completion_time'),
        difference=(float(mean), float(low), float(high)),
        path=means['shepherd_path_length'],
        path_limit=PATH_SHARE * least('shepherd_path_length'),
        spread=means['flock_spread'],
        spread_limit=least('flock_spread'),
        reached=means['fraction_reached'],
        in_goal=means['fraction_in_goal'],
        away=int((own['completed'] < 1).sum()),
    )


def comparisons(samples: Samples) -> Iterator[CellComparison]:
    """Yield each policy in each setting in which both heuristics have the same episodes."""
    for policy in samples.policies:
        for place, setting in enumerate(samples.settings):
            rows = [
                {name: samples.values[each, name][place] for name in METRICS_USED}
                for each in (policy, *BASELINES)
                if (each, METRICS_USED[0]) in samples.values
            ]
            if len(rows) == 1 + len(BASELINES) and all(
                np.isfinite(row[METRICS_USED[0]]).all() for row in rows
            ):
                yield compare(setting, policy, rows[0], rows[1:])


def criteria_page(samples: Samples, cause: str = '') -> str:
    """Return a page with the rule and, for each policy, a row a cell; cause is text below."""
    parts = [
        f'# {samples.experiment.title}\n',
        f'{len(samples.seeds)} starts of each cell, {samples.steps} steps; '
        'Strömbom flock, three shepherds and a hundred sheep unless a row says otherwise.',
        CRITERIA,
    ]
    found = list(comparisons(samples))
    for policy in dict.fromkeys(each.policy for each in found):
        own = [each for each in found if each.policy == policy]
        whole = sum(not each.missed for each in own)
        parts.append(
            f'## {label(policy)}\n\nAll five criteria are met in {whole} of {len(own)} cells. '
            'Times in steps, paths and spreads in m.\n\n' + _table(own)
        )
    return '\n'.join([*parts, *([cause + '\n'] if cause else [])])


def _table(found: list[CellComparison]) -> str:
    """Return a table with a row for each cell."""
    lines = [
        '| cell | time | less the faster heuristic | path (limit) | spread (limit) | reached '
        '| in goal | never home | missed |',
        '|:--|--:|--:|--:|--:|--:|--:|--:|:--|',
    ]
    for each in found:
        mean, low, high = each.difference
        cells = [
            describe_setting(each.setting),
            number_text(each.time),
            f'{mean:+.1f} [{low:+.1f}, {high:+.1f}]',
            f'{number_text(each.path)} ({number_text(each.path_limit)})',
            f'{number_text(each.spread)} ({number_text(each.spread_limit)})',
            f'{each.reached:.3f}',
            f'{each.in_goal:.3f}',
            str(each.away),
            ', '.join(each.missed) or 'none',
        ]
        lines.append(f'| {" | ".join(cells)} |')
    return '\n'.join(lines) + '\n'
