"""Judging of all statements in one preset, and the counts of verdicts of several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import json

from shepherd_ros.experiments.catalog import EXPERIMENTS
from shepherd_ros.experiments.samples import Samples
from shepherd_ros.paper.claims import UNDECIDED
from shepherd_ros.paper.curves import Curve
from shepherd_ros.paper.statements import CLAIMS
from shepherd_ros.paper.value_verdicts import Maps, verdicts_on_values
from shepherd_ros.paper.verdicts import (
    counts,
    single,
    Verdict,
    verdicts_on_curves,
    verdicts_on_samples,
    without_number,
)


@dataclass(frozen=True)
class Judged:
    """Verdicts on all statements of the paper in a preset."""

    preset: str
    primary: Mapping[str, str]  # flock -> policy
    samples: Mapping[str, Samples]  # by experiment
    outcomes: Sequence[Verdict]

    @property
    def counts(self) -> dict[str, int]:
        """Return how many statements have each verdict, with the primary policies."""
        return counts(self.outcomes)

    @property
    def about_baselines(self) -> dict[str, int]:
        """Return how many of the statements without RL have each verdict."""
        return counts([outcome for outcome in self.outcomes if not outcome.policy])

    def of(self, experiment: str) -> list[Verdict]:
        """Return the verdicts on the statements of an experiment, the primary ones first."""
        own = [outcome for outcome in self.outcomes if outcome.experiment == experiment]
        return sorted(own, key=lambda outcome: not outcome.primary)


def judge(
    preset: str,
    primary: Mapping[str, str],
    samples: Mapping[str, Samples],
    curves: Sequence[Curve],
    maps: Maps,
) -> Judged:
    """Return the verdicts on all statements; undecided where there are no rows."""
    outcomes = verdicts_on_curves(curves, primary)
    for name in dict.fromkeys(claim.experiment for claim in CLAIMS):
        found = samples.get(name)
        if found is not None:
            outcomes += verdicts_on_samples(found, primary[found.settings[0].flock])
            continue
        for claim in CLAIMS:
            if claim.experiment == name:
                none = [without_number(c, UNDECIDED, 'no rows') for c in claim.clauses]
                flock = EXPERIMENTS[name].settings[0].flock
                policy = primary[flock] if claim.uses_rl else ''
                outcomes.append(single(name, claim.statement, policy, *none))
    return Judged(preset, primary, samples, [*outcomes, *verdicts_on_values(maps, primary)])


def counts_as_json(judged: Sequence[Judged]) -> str:
    """Return the counts of verdicts by preset as JSON."""
    return json.dumps({each.preset: each.counts for each in judged}, indent=2) + '\n'
