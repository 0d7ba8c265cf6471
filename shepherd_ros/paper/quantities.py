"""Quantities of statements: functions of the means over an experiment's axis."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
from shepherd_ros.experiments.bootstrap import Array
from shepherd_ros.paper.claims import ABOUT_TOLERANCE, Clause, Quantity, Sweep, Where

TIME, PATH, SPREAD = 'completion_time', 'shepherd_path_length', 'flock_spread'
FLOCK, SHARE = 'flock_path_length', 'fraction_reached'
RL, S, P = 'RL', 'strombom', 'pierson'
METHODS = (RL, S, P)
FLAT_TOLERANCE = 0.1  # a curve is `constant` if it stays within this share of its first value


def about(text: str, quantity: Quantity, value: float, better: str = '') -> Clause:
    """Return the clause that a number is within ABOUT_TOLERANCE of a value."""
    low, high = (1 - ABOUT_TOLERANCE) * value, (1 + ABOUT_TOLERANCE) * value
    return Clause(text, quantity, low, high, better)


def ratio(method: str, other: str, metric: str) -> Quantity:
    """Return the ratio of two methods, each its mean over the axis."""
    return lambda s: s.mean(method, metric).mean(0) / s.mean(other, metric).mean(0)


def worst(
    metric: str, methods: tuple[str, ...], others: tuple[str, ...], where: Where | None = None
) -> Quantity:
    """Return the largest ratio over the axis of the largest method to the smallest other."""

    def quantity(s: Sweep) -> Array:
        left = np.max([s.mean(m, metric, where) for m in methods], axis=0)
        right = np.min([s.mean(m, metric, where) for m in others], axis=0)
        return (left / right).max(axis=0)

    return quantity


def below(
    text: str,
    metric: str,
    method: str,
    *others: str,
    where: Where | None = None,
    better: str = '',
) -> Clause:
    """Return the clause that a method is below all others at every point."""
    full = f'{text}: largest ratio over all points'
    return Clause(full, worst(metric, (method,), others, where), high=1.0, better=better)


def above(
    text: str,
    metric: str,
    method: str,
    *others: str,
    where: Where | None = None,
    least: float = 1.0,
    better: str = '',
) -> Clause:
    """Return the clause that a method is above all others at every point, by a factor."""
    quantity = worst(metric, others, (method,), where)
    full = f'{text}: smallest ratio over all points'
    return Clause(full, lambda s: 1 / quantity(s), low=least, better=better)


def slope(method: str, metric: str) -> Quantity:
    """Return the slope of the line through the means over the axis."""

    def quantity(s: Sweep) -> Array:
        mean = s.mean(method, metric)
        x = s.x - s.x.mean()
        if not x.any():
            return np.full(mean.shape[1], math.nan)
        return (x[:, None] * mean).sum(axis=0) / (x * x).sum()

    return quantity


def change(method: str, metric: str, first: float, last: float) -> Quantity:
    """Return the value at one point over that at another, last / first."""
    return lambda s: s.at(method, metric, last) / s.at(method, metric, first)


def lowest(metric: str, methods: tuple[str, ...], where: Where | None = None) -> Quantity:
    """Return the smallest mean of several methods over the axis."""
    return lambda s: np.min([s.mean(m, metric, where) for m in methods], axis=(0, 1))


def highest(metric: str, methods: tuple[str, ...], where: Where | None = None) -> Quantity:
    """Return the largest mean of several methods over the axis."""
    return lambda s: np.max([s.mean(m, metric, where) for m in methods], axis=(0, 1))


def flat_time(text: str, method: str, where: Where | None = None, last: float = 0.0) -> Clause:
    """Return the clause that the time is at most FLAT_TOLERANCE above that of the first point."""

    def quantity(s: Sweep) -> Array:
        if last:
            s.at(method, TIME, last)  # has to be there
        return s.mean(method, TIME, where).max(axis=0) / s.at(method, TIME, 0.0)

    return Clause(text, quantity, high=1 + FLAT_TOLERANCE)


def smallest_ratio(method: str, other: str, metric: str) -> Quantity:
    """Return the smallest ratio of two methods over the axis."""
    return lambda s: (s.mean(method, metric) / s.mean(other, metric)).min(axis=0)


def ratio_at(method: str, other: str, metric: str, x: float) -> Quantity:
    """Return the ratio of two methods at one point."""
    return lambda s: s.at(method, metric, x) / s.at(other, metric, x)


def at(method: str, metric: str, x: float) -> Quantity:
    """Return the mean at one point."""
    return lambda s: s.at(method, metric, x)


def difference_at(method: str, other: str, metric: str, x: float) -> Quantity:
    """Return the mean of a method less that of another, at one point."""
    return lambda s: s.at(method, metric, x) - s.at(other, metric, x)


def at_less(method: str, metric: str, x: float, other: float) -> Quantity:
    """Return the mean at one point less that at another."""
    return lambda s: s.at(method, metric, x) - s.at(method, metric, other)


def smallest_difference(method: str, other: str, metric: str) -> Quantity:
    """Return the smallest mean over the axis of a method less that of another."""
    return lambda s: (s.mean(method, metric) - s.mean(other, metric)).min(axis=0)


def average(method: str, metric: str) -> Quantity:
    """Return the mean over the axis."""
    return lambda s: s.mean(method, metric).mean(axis=0)


def extent(method: str, metric: str) -> Quantity:
    """Return the largest less the smallest mean over the axis."""
    return lambda s: np.ptp(s.mean(method, metric), axis=0)


def gain(method: str, first: float, last: float, base: float) -> Quantity:
    """Return the time saved from one point to another, over the time at a third."""
    return lambda s: (
        (s.at(method, TIME, first) - s.at(method, TIME, last)) / s.at(method, TIME, base)
    )


def less(method: str, metric: str, points: Where, others: Where) -> Quantity:
    """Return the mean over some points less that over others."""
    return lambda s: (
        s.mean(method, metric, points).mean(axis=0) - s.mean(method, metric, others).mean(axis=0)
    )


def quotient(left: Quantity, right: Quantity) -> Quantity:
    """Return one quantity over another."""
    return lambda s: left(s) / right(s)


def largest(quantities: Sequence[Quantity]) -> Quantity:
    """Return the largest of several quantities."""
    return lambda s: np.max([quantity(s) for quantity in quantities], axis=0)
