"""The compiled search for the nearest is a sort, cut off, wherever it begins to look."""

from itertools import product

import numpy as np
from shepherd_ros.sim.neighbors_compiled import (
    break_tie,
    kth_bound,
    select_below,
    squared_distances,
    squared_distances_of,
)


def sets(kind: str, draw: np.random.Generator) -> np.ndarray:
    """Return squared distances of 1 to 400 sheep, some of them absent."""
    count = int(draw.integers(1, 400))
    values = {
        'even': lambda: draw.random(count) * 100,
        'wide': lambda: np.exp(draw.normal(0, 12, count)),
        'ties': lambda: draw.integers(0, 6, count),
        'all equal': lambda: np.full(count, 3.0),
        'at one point': lambda: np.zeros(count),
        'a far group': lambda: draw.random(count) + 1e6 * (np.arange(count) % 3 == 0),
    }[kind]()
    squared = values.astype(np.float32)
    squared[1:][draw.random(count - 1) < 0.2] = np.inf
    return squared


def test_the_nearest_are_the_first_of_a_sort() -> None:
    for kind, guess in product(
        ['even', 'wide', 'ties', 'all equal', 'at one point', 'a far group'],
        [0.0, 1e-30, 1.0, 50.0, 1e12, np.inf, np.nan],
    ):
        draw = np.random.default_rng(7)
        for _ in range(60):
            squared = sets(kind, draw)
            count, finite = len(squared), int(np.isfinite(squared).sum())
            keep = int(draw.integers(1, finite + 1))
            who = np.arange(count) + 10
            bound = kth_bound(keep, count, squared, np.float32(guess), np.empty(count, np.float32))
            wanted = np.lexsort([-who, squared])[:keep]  # at a tie the later one is nearer
            break_tie(keep, count, squared, bound, who)
            assert np.flatnonzero(squared < bound).tolist() == sorted(wanted)


def test_of_fewer_than_are_asked_for_all_are_nearest() -> None:
    squared = np.array([np.nan, 4, np.inf, 1, np.nan], np.float32)
    bound = kth_bound(3, 5, squared, np.float32(2), np.empty(5, np.float32))
    break_tie(3, 5, squared, bound, np.arange(5))
    assert np.flatnonzero(squared < bound).tolist() == [1, 3]


def test_distances_and_who_is_below_a_bound_by_hand() -> None:
    xs = np.array([0, 3, 0, 6], np.float32)
    ys = np.array([0, 4, 1, 8], np.float32)
    squared, chosen = np.empty(4, np.float32), np.empty(4, np.int64)
    squared_distances(0, xs, ys, np.array([True, True, False, True]), squared)
    assert squared.tolist() == [np.inf, 25, np.inf, 100]
    who = np.array([3, 2, 0])
    squared_distances_of(0, xs, ys, who, 3, squared)
    assert squared[:3].tolist() == [100, 1, np.inf]
    assert select_below(np.float32(100), 3, squared, who, chosen) == 1  # a bound is below none
    assert chosen[0] == 2
