"""Neighbors in a flock: those within a distance, and the k nearest ones."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np
from shepherd_ros.sim.compiled import compiled

_INF = np.float32(np.inf)
_FEW = 4  # between the bounds: so few are looked at one by one
_TRIES = 16  # at a bound, before all that are left are looked at one by one


@compiled
def squares(i, xs, ys, mask, squared):
    """Write squared distances from sheep i into squared (N,) m^2; inf: itself and the absent."""
    x, y = xs[i], ys[i]
    for j in range(xs.shape[0]):
        dx, dy = x - xs[j], y - ys[j]
        squared[j] = dx * dx + dy * dy if mask[j] else _INF
    squared[i] = _INF


@compiled
def squares_of(i, xs, ys, who, count, squared):
    """Write the squared distance from sheep i to each of who into squared m^2; inf: itself."""
    x, y = xs[i], ys[i]
    for k in range(count):
        j = who[k]
        dx, dy = x - xs[j], y - ys[j]
        squared[k] = dx * dx + dy * dy if j != i else _INF


@compiled
def choose_below(bound, count, squared, who, chosen):
    """Write those of who that are nearer than the bound [m^2] into chosen; return how many."""
    found = np.uintp(0)  # unsigned: an index that is never taken for a negative one
    for k in range(count):
        chosen[found] = who[k]
        found += np.uintp(squared[k] < bound)
    return np.intp(found)


@compiled
def in_reach(x, y, others, mask, reach, chosen):
    """Write which of the others (K, 2) m are within reach of x, y into chosen; return how many."""
    count = 0
    for k in range(others.shape[0]):
        dx, dy = x - others[k, 0], y - others[k, 1]
        if mask[k] and dx * dx + dy * dy < reach * reach:
            chosen[count] = k
            count += 1
    return count


@compiled
def _count(bound, count, squared):
    """Return how many of squared[:count] are below the bound."""
    found = 0
    for j in range(count):
        found += squared[j] < bound
    return found


@compiled
def _smallest(k, low, high, values):
    """Return the value that would be at k if values[low:high + 1] were sorted (Hoare 1961)."""
    while low < high:
        pivot, i, j = values[(low + high) // 2], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    return values[k]


@compiled
def bound_of(keep, count, squared, guess, values):
    """
    Return a bound below which the keep smallest of squared[:count] are, and more only at a tie.

    guess is where to look first; values (count,) is used on the way. keep is at least 1; where
    fewer are finite, as beside a sheep that is not a number, the bound is inf.
    """
    low, high, under, over = np.float32(0), _INF, 0, count
    bound = guess if guess > 0 else np.float32(1)
    for _ in range(_TRIES):
        found = _count(bound, count, squared)
        if found == keep:
            return bound
        if found < keep:
            low, under = bound, found
        else:
            high, over = bound, found
        if over - under <= _FEW:
            break
        if high == _INF:  # the number below a bound grows about like the bound, an area
            bound = bound * np.float32(1.1 * (keep + 1) / (found + 1))
        else:
            share = np.float32((keep - under) / (over - under))
            bound = low + (high - low) * share
        if not low < bound < high:
            break
    left = 0
    for j in range(count):
        values[left] = squared[j]
        left += low <= squared[j] < high
    if left < keep - under:
        return _INF
    return np.nextafter(_smallest(keep - under - 1, 0, left - 1, values), _INF)


@compiled
def break_tie(keep, count, squared, bound, who):
    """
    Put those of who out of squared [m^2] that are more than keep below the bound of bound_of().

    At a tie those with the larger number are nearer.
    """
    surplus = _count(bound, count, squared) - keep
    if surplus <= 0:
        return
    tie = np.float32(0)
    for k in range(count):
        if squared[k] < bound:
            tie = max(tie, squared[k])
    for _ in range(surplus):
        out = -1
        for k in range(count):
            if squared[k] == tie and (out < 0 or who[k] < who[out]):
                out = k
        squared[out] = _INF
