"""Criteria of a policy in a cell, on episodes whose means are worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shepherd_ros.experiments.catalog import EXPERIMENTS
from shepherd_ros.experiments.criteria import compare, comparisons, criteria_page, METRICS_USED
from shepherd_ros.experiments.samples import Samples
from shepherd_ros.experiments.setting import canonical_setting, Setting

POLICY = 'policy:general'
# means of two starts: completion time, path, spread, reached, in goal, completed
EPISODES = {
    POLICY: ([90, 110], [40, 60], [2.0, 2.0], [1.0, 1.0], [0.98, 0.98], [1, 1]),
    'strombom': ([80, 120], [300, 100], [4.0, 4.0], [1.0, 1.0], [0.3, 0.3], [1, 1]),
    'pierson': ([150, 90], [90, 110], [2.0, 3.0], [1.0, 0.9], [0.4, 0.4], [1, 0]),
}


def rows_of(name: str) -> dict[str, np.ndarray]:
    """Return the episodes of a controller, (2,) a metric."""
    return {m: np.array(v, float) for m, v in zip(METRICS_USED, EPISODES[name], strict=True)}


def test_each_number_is_compared_with_the_better_heuristic_in_it() -> None:
    others = [rows_of('strombom'), rows_of('pierson')]
    found = compare(Setting(), POLICY, rows_of(POLICY), others)
    # Strömbom is faster, 100 and 120; paired with it the differences are 10 and -10
    assert (found.time, found.time_limit, found.difference[0]) == (100, 100, 0)
    assert found.difference[1:] == (-10, 10)
    # Pierson has the shorter path, 200 and 100, and the smaller spread, 4 and 2.5
    assert (found.path, found.path_limit) == (50, 50)
    assert (found.spread, found.spread_limit) == (2.0, 2.5)
    assert (found.reached, found.in_goal, found.away) == (1.0, 0.98, 0)
    assert found.missed == []


@pytest.mark.parametrize(
    ('metric', 'values', 'missed'),
    [
        ('completion_time', [93, 111], []),  # 102 of 100: the margin
        ('completion_time', [94, 111], ['time']),
        ('shepherd_path_length', [40, 61], ['path']),
        ('flock_spread', [2.5, 2.6], ['spread']),
        ('fraction_reached', [0.99, 0.98], ['held']),
        ('fraction_in_goal', [1.0, 0.95], ['held']),
        ('completed', [1, 0], ['home']),
    ],
)
def test_a_criterion_is_missed_just_beyond_its_limit(
    metric: str, values: list[float], missed: list[str]
) -> None:
    own = rows_of(POLICY) | {metric: np.array(values, float)}
    others = [rows_of('strombom'), rows_of('pierson')]
    assert compare(Setting(), POLICY, own, others).missed == missed


def test_the_page_has_a_row_for_each_cell_that_both_heuristics_have() -> None:
    settings = tuple(map(canonical_setting, (Setting(), Setting(shepherds=1))))
    values = {
        (name, metric): np.stack([episodes, episodes])
        for name in EPISODES
        for metric, episodes in rows_of(name).items()
    }
    values['pierson', 'completion_time'] = np.array([[150, 90], [np.nan, np.nan]])
    values[POLICY, 'fraction_in_goal'] = np.array([[0.98, 0.97], [1.0, 1.0]])
    samples = Samples(EXPERIMENTS['cells'], settings, (0, 1), 1000, values)
    assert [each.setting for each in comparisons(samples)] == [settings[0]]
    page = criteria_page(samples, 'One sheep strays.')
    assert 'All five criteria are met in 0 of 1 cells' in page
    row = next(line for line in page.splitlines() if line.startswith('| default setting'))
    assert row.endswith('| 1.000 | 0.975 | 0 | held |')
    assert page.endswith('One sheep strays.\n')
    alone = {key: v for key, v in values.items() if key[0] != 'strombom'}
    assert list(comparisons(replace(samples, values=alone))) == []
