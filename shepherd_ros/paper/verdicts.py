"""Verdicts on the statements of the paper from our rows and curves."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from shepherd_ros.experiments.methods import checkpoint_of
from shepherd_ros.experiments.samples import Samples
from shepherd_ros.paper.claims import (
    Claim,
    Clause,
    ClauseFinding,
    combined_verdict,
    finding_of,
    Sweep,
    TO_COMPLETION,
    UNDECIDED,
    VERDICTS,
)
from shepherd_ros.paper.curves import Curve, curve_verdict
from shepherd_ros.paper.primary import trained_on
from shepherd_ros.paper.statements import CLAIMS


@dataclass(frozen=True)
class Verdict:
    """A statement, the policy that stands for RL in it, and the findings on its clauses."""

    experiment: str
    statement: str
    policy: str  # full name; empty where RL does not matter
    findings: tuple[ClauseFinding, ...]
    until_completion: tuple[
        ClauseFinding | None, ...
    ]  # with paths counted until then; None: no path
    primary: bool = True  # RL does not matter, or is the primary policy; False: a variant

    @property
    def verdict(self) -> str:
        """Return the verdict on the whole statement."""
        return combined_verdict([finding.verdict for finding in self.findings])

    @property
    def strict(self) -> str:
        """Return the verdict by the bounds alone, which knows no `better`."""
        return combined_verdict([finding.strict for finding in self.findings])


def counts(outcomes: Sequence[Verdict]) -> dict[str, int]:
    """Return how many statements have each verdict, with the primary policies."""
    found = Counter(outcome.verdict for outcome in outcomes if outcome.primary)
    return {kind: found[kind] for kind in VERDICTS}


def verdicts_on_samples(
    samples: Samples, primary: str, claims: Sequence[Claim] = CLAIMS
) -> list[Verdict]:
    """Return the verdicts on an experiment: with the primary policy, then with each variant."""
    outcomes: dict[tuple[str, str], Verdict] = {}
    variants = [policy for policy in samples.policies if policy != primary]
    for claim in claims:
        if claim.experiment != samples.experiment.name:
            continue
        for policy in (primary, *variants):
            outcome = _judge_claim(claim, samples, policy)
            with_rl = replace(outcome, primary=policy == primary)
            outcomes.setdefault(
                (claim.statement, outcome.policy), with_rl if outcome.policy else outcome
            )
    return list(outcomes.values())


def _judge_claim(claim: Claim, samples: Samples, policy: str) -> Verdict:
    """Return the verdict on a claim with a policy in the place of RL."""
    findings, others, with_rl = [], [], claim.uses_rl
    for clause in claim.clauses:
        sweep = Sweep(samples, policy)
        finding = finding_of(clause, sweep)
        uses_rl = any(method == 'RL' for method, _ in sweep.used_means)
        if (
            uses_rl
            and claim.experiment == 'fig8'
            and policy in samples.policies
            and 'reynolds' not in trained_on(policy)
        ):
            finding = replace(
                finding,
                verdict=UNDECIDED,
                strict=UNDECIDED,
                reason='not trained with the Reynolds flock',
            )
        findings.append(finding)
        paths = any(metric in TO_COMPLETION for _, metric in sweep.used_means)
        others.append(finding_of(clause, Sweep(samples, policy, True)) if paths else None)
    return Verdict(
        claim.experiment,
        claim.statement,
        policy if with_rl else '',
        tuple(findings),
        tuple(others),
    )


def bare_clause(text: str, low: float = -math.inf) -> Clause:
    """Return a clause whose number does not come from rows."""
    return Clause(text, lambda sweep: np.zeros(1), low)


def single(
    experiment: str, statement: str, policy: str, *findings: ClauseFinding, primary: bool = True
) -> Verdict:
    """Return the verdict on a statement that has no path."""
    none = (None,) * len(findings)
    return Verdict(experiment, statement, policy, findings, none, primary)


def without_number(clause: Clause, result: str, reason: str) -> ClauseFinding:
    """Return a finding that has a reason, but no number."""
    nan = math.nan
    return ClauseFinding(clause, nan, nan, nan, result, reason, result)


def verdicts_on_curves(curves: Sequence[Curve], primary: Mapping[str, str]) -> list[Verdict]:
    """
    Return the verdict on figure 3 for each policy, with a finding for each training.

    Those of the primary policies (by flock) are judged together, first, and undecided without a
    curve.
    """
    statement = 'The return rises and flattens within 100 million samples'
    found: dict[str, list[ClauseFinding]] = {}
    for curve in curves:
        finding = without_number(bare_clause(curve.name), *curve_verdict(curve))
        found.setdefault(f'policy:{curve.policy}', []).append(finding)
    of_primary: list[ClauseFinding] = []
    for name in dict.fromkeys(primary.values()):
        missing = without_number(
            bare_clause(checkpoint_of(name)), UNDECIDED, f'no curve of {checkpoint_of(name)}'
        )
        of_primary += found.pop(name, [missing])
    together = single(
        'fig3', statement, ' and '.join(dict.fromkeys(primary.values())), *of_primary
    )
    variants = (single('fig3', statement, n, *f, primary=False) for n, f in found.items())
    return [together, *variants]
