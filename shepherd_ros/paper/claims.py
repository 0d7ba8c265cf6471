"""Claims of the paper (section 5) as quantities with bounds, and the rule of a verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from shepherd_ros.experiments.bootstrap import Array, CONFIDENCE, percentiles, resampled_means
from shepherd_ros.experiments.samples import Samples

AGREES, BETTER, DISAGREES, UNDECIDED = VERDICTS = ('agrees', 'better', 'disagrees', 'undecided')
ABOVE, BELOW = 'above', 'below'  # sides of bounds
ABOUT_TOLERANCE = 0.2  # a ratio is `about` a value if it is within this share of it
SHARE_TOLERANCE = 0.02  # a fraction is near a value if it is within this
HIGH_SHARE = 0.9  # a `high` share of the flock

# what is counted until completion instead of over the whole episode
TO_COMPLETION = {
    'shepherd_path_length': 'shepherd_path_to_completion',
    'flock_path_length': 'flock_path_to_completion',
}


Where = Callable[[Array], NDArray[np.bool_]]  # which points of the axis


class MissingError(Exception):
    """Error for a quantity whose rows are missing."""


class Sweep:
    """Means over the axis of an experiment, (P, draws) each, of a policy and the baselines."""

    def __init__(self, samples: Samples, policy: str, to_completion: bool = False) -> None:
        """Use samples; policy stands for the paper's RL, '' without one."""
        self.samples, self.policy, self.to_completion = samples, policy, to_completion
        self.used_means: set[tuple[str, str]] = set()  # method and metric
        self.used_points = np.zeros(len(samples.settings), bool)
        axis = samples.experiment.axes[0]
        points = range(len(samples.settings)) if axis == 'case' else samples.axis(axis)
        self.x: Array = np.array([float(x) for x in points])

    def mean(self, method: str, metric: str, where: Where | None = None) -> Array:
        """Return means of RL, strombom or pierson, (P, 1 + draws): the mean, then resamples."""
        self.used_means.add((method, metric))
        name = self.policy if method == 'RL' else method
        metric = TO_COMPLETION.get(metric, metric) if self.to_completion else metric
        if (name, metric) not in self.samples.values:
            raise MissingError(f'no rows of {name or "a policy"}')
        values = self.samples.values[name, metric]
        chosen = np.ones(len(values), bool) if where is None else np.asarray(where(self.x))
        if not chosen.any():
            raise MissingError('no rows at these points')
        self.used_points |= chosen
        values = values[chosen]
        if np.isnan(values).any():
            raise MissingError(f'rows of {name} are not complete')
        mean = values.mean(axis=-1, keepdims=True)
        return np.concatenate([mean, resampled_means(values)], axis=-1)

    def at(self, method: str, metric: str, x: float) -> Array:
        """Return the means at one point, (1 + draws,)."""
        return self.mean(method, metric, lambda axis: np.isclose(axis, x))[0]

    def brings_home(self) -> bool:
        """Return whether RL, if it was used, brings a high share home at every used point."""
        if not any(method == 'RL' for method, _ in self.used_means):
            return True
        shares = self.samples.values[self.policy, 'fraction_reached'][self.used_points]
        return bool(shares.mean(axis=-1).min() >= HIGH_SHARE)


Quantity = Callable[[Sweep], Array]  # -> (1 + draws,)


@dataclass(frozen=True)
class Clause:
    """
    A number, and the bounds within which it agrees with the paper.

    better is the side of the bounds on which it is better for whom RL drives: a shorter time or
    path, a tighter flock, more sheep home. Of a baseline alone only more sheep home is better, and
    not where the paper states that it fails.
    """

    text: str
    quantity: Quantity
    low: float = -math.inf
    high: float = math.inf
    better: str = ''

    @property
    def bounds(self) -> str:
        """Return the bounds in words."""
        if math.isinf(self.low):
            return f'below {self.high:.3g}'
        if math.isinf(self.high):
            return f'above {self.low:.3g}'
        return f'{self.low:.3g} to {self.high:.3g}'


@dataclass(frozen=True)
class Claim:
    """A statement of the paper about one experiment; it holds if all its clauses do."""

    experiment: str
    statement: str
    clauses: tuple[Clause, ...]

    @property
    def uses_rl(self) -> bool:
        """Return whether RL matters to the statement."""
        probe = _Probe()
        with np.errstate(all='ignore'):
            for clause in self.clauses:
                clause.quantity(probe)
        return any(method == 'RL' for method, _ in probe.used_means)


class _Probe(Sweep):
    """Sweep without rows, which only notes what a quantity asks for."""

    def __init__(self) -> None:
        """Begin with nothing asked for."""
        self.used_means, self.x = set(), np.arange(2.0)

    def mean(self, method: str, metric: str, where: Where | None = None) -> Array:
        """Return ones for two points and two draws."""
        self.used_means.add((method, metric))
        return np.ones((2, 2))

    def at(self, method: str, metric: str, x: float) -> Array:
        """Return ones for two draws."""
        return self.mean(method, metric)[0]


@dataclass(frozen=True)
class ClauseFinding:
    """
    Result of a clause: our number, its interval, the verdict, or the reason for none.

    strict is the verdict by the bounds alone, which knows no `better`.
    """

    clause: Clause
    value: float
    low: float
    high: float
    verdict: str
    reason: str = ''
    strict: str = UNDECIDED


def strict_verdict(low: float, high: float, lower: float, upper: float) -> str:
    """
    Return the verdict on a number with interval [low, high] and bounds [lower, upper].

    Agrees if the whole interval lies within the bounds, disagrees if none of it does, else
    undecided; also undecided without an interval.
    """
    if not (math.isfinite(low) and math.isfinite(high)):
        return UNDECIDED
    if lower <= low and high <= upper:
        return AGREES
    return DISAGREES if high < lower or low > upper else UNDECIDED


def verdict(low: float, high: float, lower: float, upper: float, better: str = '') -> str:
    """
    Return the verdict on a number, one side of whose bounds may be better.

    Where strict_verdict() disagrees, it is `better` on that side. With a bound on the other side,
    too, it also agrees where the interval crosses the bound to the better side alone.
    """
    strict = strict_verdict(low, high, lower, upper)
    if better == BELOW:  # mirrored
        low, high, lower, upper = -high, -low, -upper, -lower
    if not better or strict == AGREES:
        return strict
    if strict == DISAGREES:
        return BETTER if low > upper else DISAGREES
    known = math.isfinite(low) and math.isfinite(high) and math.isfinite(lower)
    return AGREES if known and lower <= low <= upper else UNDECIDED


def finding_of(clause: Clause, sweep: Sweep, confidence: float = CONFIDENCE) -> ClauseFinding:
    """Return the finding on a clause; nothing is better where RL leaves sheep behind."""
    nan = math.nan
    if len(sweep.samples.seeds) < 2:
        return ClauseFinding(clause, nan, nan, nan, UNDECIDED, 'a single episode has no interval')
    try:
        with np.errstate(divide='ignore', invalid='ignore'):  # then there is no verdict
            resampled = clause.quantity(sweep)
    except MissingError as error:
        return ClauseFinding(clause, nan, nan, nan, UNDECIDED, str(error))
    low, high = (float(end) for end in percentiles(resampled[1:], confidence))
    strict = strict_verdict(low, high, clause.low, clause.high)
    result, reason = verdict(low, high, clause.low, clause.high, clause.better), ''
    if result != strict and not sweep.brings_home():
        result, reason = strict, f'no better, as RL brings less than {HIGH_SHARE} home'
    return ClauseFinding(clause, float(resampled[0]), low, high, result, reason, strict)


def combined_verdict(verdicts: list[str]) -> str:
    """Return the verdict on a statement from those on its clauses."""
    for kind in (DISAGREES, UNDECIDED, BETTER):
        if kind in verdicts:
            return kind
    return AGREES if verdicts else UNDECIDED
