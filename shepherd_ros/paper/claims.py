"""Claims of the paper (section 5) as quantities with bounds, and the rule of a verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from shepherd_ros.experiments.bootstrap import Array, percentiles, resampled_means
from shepherd_ros.experiments.samples import Samples

AGREES, DISAGREES, UNDECIDED = 'agrees', 'disagrees', 'undecided'
ABOUT_TOLERANCE = 0.2  # a ratio is `about` a value if it is within this share of it
SHARE_TOLERANCE = 0.02  # a fraction is near a value if it is within this

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
        if where is not None:
            chosen = where(self.x)
            if not bool(np.any(chosen)):
                raise MissingError('no rows at these points')
            values = values[chosen]
        if np.isnan(values).any():
            raise MissingError(f'rows of {name} are not complete')
        mean = values.mean(axis=-1, keepdims=True)
        return np.concatenate([mean, resampled_means(values)], axis=-1)

    def at(self, method: str, metric: str, x: float) -> Array:
        """Return the means at one point, (1 + draws,)."""
        return self.mean(method, metric, lambda axis: np.isclose(axis, x))[0]


Quantity = Callable[[Sweep], Array]  # -> (1 + draws,)


@dataclass(frozen=True)
class Clause:
    """A number, and the bounds within which it agrees with the paper."""

    text: str
    quantity: Quantity
    low: float = -math.inf
    high: float = math.inf

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


@dataclass(frozen=True)
class ClauseFinding:
    """Result of a clause: our number, its interval, the verdict, or the reason for none."""

    clause: Clause
    value: float
    low: float
    high: float
    verdict: str
    reason: str = ''


def verdict(low: float, high: float, lower: float, upper: float) -> str:
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


def finding_of(clause: Clause, sweep: Sweep) -> ClauseFinding:
    """Return the finding on a clause."""
    nan = math.nan
    if len(sweep.samples.seeds) < 2:
        return ClauseFinding(clause, nan, nan, nan, UNDECIDED, 'a single episode has no interval')
    try:
        with np.errstate(divide='ignore', invalid='ignore'):  # then there is no verdict
            resampled = clause.quantity(sweep)
    except MissingError as error:
        return ClauseFinding(clause, nan, nan, nan, UNDECIDED, str(error))
    low, high = (float(end) for end in percentiles(resampled[1:]))
    return ClauseFinding(
        clause, float(resampled[0]), low, high, verdict(low, high, clause.low, clause.high)
    )


def combined_verdict(verdicts: list[str]) -> str:
    """Return the verdict on a statement from those on its clauses."""
    if DISAGREES in verdicts:
        return DISAGREES
    return AGREES if verdicts and set(verdicts) == {AGREES} else UNDECIDED
