"""Verdicts on the statements of the paper from our rows, curves and critics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from shepherd_ros.experiments.bootstrap import Array, mean_interval
from shepherd_ros.experiments.methods import checkpoint_of, label, loaded, training_of
from shepherd_ros.experiments.samples import Samples
from shepherd_ros.experiments.value_map import BEHIND_COSINE, value_map
from shepherd_ros.paper.claims import (
    Claim,
    Clause,
    ClauseFinding,
    combined_verdict,
    finding_of,
    Sweep,
    TO_COMPLETION,
    UNDECIDED,
    verdict,
)
from shepherd_ros.paper.curves import Curve, curve_verdict
from shepherd_ros.paper.statements import CLAIMS
from shepherd_ros.sim.flocking import PAPER_FLOCKS

N_VALUE_MAPS = 20  # starts of which the critic's values are looked at


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
    counts: bool = True  # who stands for RL was trained as in the paper: PPO, on this flock alone

    @property
    def verdict(self) -> str:
        """Return the verdict on the whole statement."""
        return combined_verdict([finding.verdict for finding in self.findings])


def has_critic(policy: str) -> bool:
    """Return whether a policy's critic was trained: only PPO does that."""
    return 'ppo' in training_of(policy)


def trained_on(policy: str) -> set[str]:
    """Return the flocks that a policy was trained with, from its checkpoint."""
    task = training_of(policy).get('task')
    flock = task.get('flock') if isinstance(task, dict) else None
    return set(PAPER_FLOCKS) if flock == 'both' else {str(flock)}


def is_trained_as_in_paper(policy: str, flock: str) -> bool:
    """Return whether a policy was trained as the paper's RL for a flock model; true for none."""
    return not policy or (has_critic(policy) and trained_on(policy) == {flock})


def verdicts_on_samples(samples: Samples) -> list[Verdict]:
    """Return the verdicts on an experiment, for each policy that was evaluated in it."""
    outcomes: dict[tuple[str, str], Verdict] = {}
    for claim in CLAIMS:
        if claim.experiment != samples.experiment.name:
            continue
        for policy in samples.policies or ['']:
            outcome = _judge_claim(claim, samples, policy)
            outcomes.setdefault((claim.statement, outcome.policy), outcome)
    return list(outcomes.values())


def _judge_claim(claim: Claim, samples: Samples, policy: str) -> Verdict:
    """Return the verdict on a claim with a policy in the place of RL."""
    findings, others, with_rl = [], [], False
    for clause in claim.clauses:
        sweep = Sweep(samples, policy)
        finding = finding_of(clause, sweep)
        uses_rl = any(method == 'RL' for method, _ in sweep.used_means)
        with_rl |= uses_rl
        if (
            uses_rl
            and policy
            and claim.experiment == 'fig8'
            and 'reynolds' not in trained_on(policy)
        ):
            finding = replace(
                finding, verdict=UNDECIDED, reason='not trained with the Reynolds flock'
            )
        findings.append(finding)
        paths = any(metric in TO_COMPLETION for _, metric in sweep.used_means)
        others.append(finding_of(clause, Sweep(samples, policy, True)) if paths else None)
    return Verdict(
        claim.experiment,
        claim.statement,
        (policy or 'none') if with_rl else '',
        tuple(findings),
        tuple(others),
        not with_rl or is_trained_as_in_paper(policy, samples.settings[0].flock),
    )


def _plain(text: str) -> Clause:
    """Return a clause whose verdict does not come from rows."""
    return Clause(text, lambda sweep: np.zeros(1))


def _single(
    experiment: str, statement: str, policy: str, *findings: ClauseFinding, counts: bool = True
) -> Verdict:
    return Verdict(experiment, statement, policy, findings, (None,) * len(findings), counts)


def verdicts_on_curves(curves: Sequence[Curve]) -> list[Verdict]:
    """Return the verdict on figure 3 for each policy, with a finding for each training."""
    statement, outcomes = 'The return rises and flattens within 100 million samples', []
    for policy in dict.fromkeys(curve.policy for curve in curves):
        own, findings = [curve for curve in curves if curve.policy == policy], []
        for curve in own:
            result, reason = curve_verdict(curve)
            numbers = (math.nan, math.nan, math.nan)
            findings.append(ClauseFinding(_plain(curve.name), *numbers, result, reason))
        by_reward = not own[0].judged  # other trainings know no reward
        outcomes.append(_single('fig3', statement, policy, *findings, counts=by_reward))
    if outcomes:
        return outcomes
    missing = ClauseFinding(_plain('curve'), math.nan, math.nan, math.nan, UNDECIDED, 'no curves')
    return [_single('fig3', statement, 'none', missing)]


def verdicts_on_values(policies: Sequence[str]) -> list[Verdict]:
    """Return the verdicts on figure 9 for policies with critics."""
    behind = 'The best place for a third shepherd is behind the flock, seen from the goal'
    areas = 'The areas of high value are large for the Strömbom flock, small for Reynolds'
    nan = math.nan
    outcomes: list[Verdict] = []
    shares: dict[str, dict[str, Array]] = {'strombom': {}, 'reynolds': {}}  # by flock and policy
    for policy in policies:
        maps = [value_map(loaded(checkpoint_of(policy)), seed) for seed in range(N_VALUE_MAPS)]
        value, low, high = map(float, mean_interval(np.array([m.behind for m in maps])))
        clause = Clause(
            'cosine between best place and straight behind', _plain('').quantity, BEHIND_COSINE
        )
        finding = ClauseFinding(
            clause, value, low, high, verdict(low, high, BEHIND_COSINE, math.inf)
        )
        outcomes.append(_single('fig9', behind, policy, finding))
        for flock in trained_on(policy):
            shares[flock][policy] = np.array([m.high_share for m in maps])
    if not outcomes:
        reason = 'no checkpoint with a trained critic'
        missing = ClauseFinding(_plain('critic'), nan, nan, nan, UNDECIDED, reason)
        outcomes = [_single('fig9', behind, 'none', missing)]
    clause = Clause(
        'share of the plane with high values, Strömbom over Reynolds', _plain('').quantity, 1.0
    )
    pairs = [
        (left, right, left_shares / right_shares)
        for left, left_shares in shares['strombom'].items()
        for right, right_shares in shares['reynolds'].items()
    ]
    for left, right, ratios in pairs:
        value, low, high = map(float, mean_interval(ratios))
        finding = ClauseFinding(clause, value, low, high, verdict(low, high, 1.0, math.inf))
        outcomes.append(_single('fig9', areas, f'{label(left)} and {label(right)}', finding))
    if pairs:
        return outcomes
    reason = 'needs critics trained with both flocks'
    missing = ClauseFinding(clause, nan, nan, nan, UNDECIDED, reason)
    return [*outcomes, _single('fig9', areas, 'none', missing)]
