"""Verdicts on figure 9 from the critics of policies, over many flocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math

import numpy as np
from shepherd_ros.experiments.bootstrap import Array, mean_interval
from shepherd_ros.experiments.methods import checkpoint_of, label, loaded
from shepherd_ros.experiments.value_map import BEHIND_COSINE, value_map, ValueMap
from shepherd_ros.paper.claims import Clause, ClauseFinding, strict_verdict, UNDECIDED
from shepherd_ros.paper.primary import trained_on
from shepherd_ros.paper.verdicts import bare_clause, single, Verdict, without_number

N_VALUE_MAPS = 20  # flocks of which the critic's values are looked at
BEHIND = 'The best place for a third shepherd is behind the flock, seen from the goal'
AREAS = 'The areas of high value are large for the Strömbom flock, small for Reynolds'
COSINE = 'cosine between the best 5 x 5 places and straight behind'
GRADIENT = 'value behind less that in front, near the flock, over the range of values'
AREA_RATIO = 'share of the plane with high values, Strömbom over Reynolds'

Maps = Mapping[str, Sequence[ValueMap]]  # by policy


def value_maps(policy: str) -> list[ValueMap]:
    """Return the value maps of a policy, one for each flock."""
    return [value_map(loaded(checkpoint_of(policy)), seed) for seed in range(N_VALUE_MAPS)]


def verdicts_on_values(maps: Maps, primary: Mapping[str, str]) -> list[Verdict]:
    """
    Return the verdicts on figure 9 from value maps of policies with a critic.

    The two primary policies (by flock) are judged together, as the paper shows both maps; each
    other is judged alone, and its areas against those of the primary policy of the other flock.
    """
    primaries = (primary['strombom'], primary['reynolds'])
    numbers = [finding for policy in primaries for finding in _behind(policy, maps)]
    outcomes = [
        single('fig9', BEHIND, _names(*primaries), *numbers),
        single('fig9', AREAS, _names(*primaries), _areas(*primaries, maps)),
    ]
    for policy in maps:
        if policy in primaries:
            continue
        outcomes.append(single('fig9', BEHIND, policy, *_behind(policy, maps), primary=False))
        flocks = trained_on(policy)
        for pair in ((policy, primaries[1]), (primaries[0], policy)):
            if flocks == {'strombom' if pair[0] == policy else 'reynolds'}:
                finding = _areas(*pair, maps)
                outcomes.append(single('fig9', AREAS, policy, finding, primary=False))
    return outcomes


def _names(strombom: str, reynolds: str) -> str:
    return strombom if strombom == reynolds else f'{strombom} and {reynolds}'


def _number(clause: Clause, values: Array) -> ClauseFinding:
    """Return the finding on a number of each flock, (flocks,)."""
    value, low, high = map(float, mean_interval(values))
    result = strict_verdict(low, high, clause.low, clause.high)
    return ClauseFinding(clause, value, low, high, result, strict=result)


def _behind(policy: str, maps: Maps) -> list[ClauseFinding]:
    """Return the findings on where a policy's values are high."""
    clauses = [
        bare_clause(f'{label(policy)}: {COSINE}', BEHIND_COSINE),
        bare_clause(f'{label(policy)}: {GRADIENT}', 0.0),
    ]
    if policy not in maps:
        return [without_number(clause, UNDECIDED, _no_critic(policy)) for clause in clauses]
    own = maps[policy]
    numbers = ([m.behind for m in own], [m.gradient for m in own])
    return [_number(c, np.array(n)) for c, n in zip(clauses, numbers, strict=True)]


def _areas(strombom: str, reynolds: str, maps: Maps) -> ClauseFinding:
    """Return the finding on the areas of high value of two policies, flock by flock."""
    clause = bare_clause(AREA_RATIO, 1.0)
    for policy in (strombom, reynolds):
        if policy not in maps:
            return without_number(clause, UNDECIDED, _no_critic(policy))
    left, right = ([m.high_share for m in maps[name]] for name in (strombom, reynolds))
    return _number(clause, np.array(left) / np.maximum(np.array(right), math.ulp(1.0)))


def _no_critic(policy: str) -> str:
    return f'no trained critic of {label(policy)}'
