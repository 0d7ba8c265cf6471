"""Neighbors in a flock: those within a distance, and the k nearest ones."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np
from shepherd_ros.sim.compiled import compiled

_INF = np.float32(np.inf)
_SEARCH_LIMIT = 4  # values between the bounds that are selected by partition
_MAX_ITERATIONS = 16  # of the search for a bound, before the rest is selected by partition


@compiled
def squared_distances(i, xs, ys, mask, squared):
    """Write squared distances from sheep i into squared (N,) m^2; inf: itself and the absent."""
    x, y = xs[i], ys[i]
    for j in range(xs.shape[0]):
        dx, dy = x - xs[j], y - ys[j]
        squared[j] = dx * dx + dy * dy if mask[j] else _INF
    squared[i] = _INF


@compiled
def squared_distances_of(i, xs, ys, candidates, count, squared):
    """Write the squared distance from sheep i to each candidate into squared m^2; inf: itself."""
    x, y = xs[i], ys[i]
    for k in range(count):
        j = candidates[k]
        dx, dy = x - xs[j], y - ys[j]
        squared[k] = dx * dx + dy * dy if j != i else _INF


@compiled
def select_below(bound, count, squared, candidates, chosen):
    """Write the candidates nearer than the bound [m^2] into chosen; return their number."""
    selected = np.uintp(0)  # unsigned: an index that is never taken for a negative one
    for k in range(count):
        chosen[selected] = candidates[k]
        selected += np.uintp(squared[k] < bound)
    return np.intp(selected)


@compiled
def in_reach(x, y, others, mask, reach, chosen):
    """Write those of others (K, 2) m within reach of x, y into chosen; return their number."""
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
    below = 0
    for j in range(count):
        below += squared[j] < bound
    return below


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
def kth_bound(keep, count, squared, guess, values):
    """
    Return a bound below which the keep smallest of squared[:count] are, and more only at a tie.

    guess is the bound tried first; values (count,) is memory to work in. keep is at least 1;
    where fewer are finite, as beside a sheep that is not a number, the bound is inf.
    """
    low, high, under, over = np.float32(0), _INF, 0, count
    bound = guess if guess > 0 else np.float32(1)
    for _ in range(_MAX_ITERATIONS):
        below = _count(bound, count, squared)
        if below == keep:
            return bound
        if below < keep:
            low, under = bound, below
        else:
            high, over = bound, below
        if over - under <= _SEARCH_LIMIT:
            break
        if high == _INF:  # the number below a bound grows about like the bound, an area
            bound = bound * np.float32(1.1 * (keep + 1) / (below + 1))
        else:
            fraction = np.float32((keep - under) / (over - under))
            bound = low + (high - low) * fraction
        if not low < bound < high:
            break
    n_values = 0
    for j in range(count):
        values[n_values] = squared[j]
        n_values += low <= squared[j] < high
    if n_values < keep - under:
        return _INF
    return np.nextafter(_smallest(keep - under - 1, 0, n_values - 1, values), _INF)


@compiled
def break_tie(keep, count, squared, bound, candidates):
    """
    Set the surplus of more than `keep` below the bound of kth_bound() to inf in squared [m^2].

    At a tie those with the larger index are nearer.
    """
    surplus = _count(bound, count, squared) - keep
    if surplus <= 0:
        return
    tie = np.float32(0)
    for k in range(count):
        if squared[k] < bound:
            tie = max(tie, squared[k])
    for _ in range(surplus):
        farthest = -1
        for k in range(count):
            if squared[k] == tie and (farthest < 0 or candidates[k] < candidates[farthest]):
                farthest = k
        squared[farthest] = _INF
