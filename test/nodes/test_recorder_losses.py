"""Losses of a recorder, by the numbers that publishers give their messages."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st
import pytest
from shepherd_ros.nodes.recorder_losses import Losses


def received(numbers: list[int], publishers: int = 1) -> tuple[int, list[list[int]]]:
    """Return how many of the numbers of one topic are missing, and the runs they make."""
    existing = {bytes([k]) for k in range(publishers)}
    losses = Losses(lambda topic: existing)
    for number in numbers:
        losses.count_message('/a', number)
    runs = [[run.first, run.last] for run in losses.topics['/a'].runs]
    return losses.by_topic().total(), runs


def test_gaps_in_the_numbering_are_losses() -> None:
    assert received([5, 6, 9, 10]) == (2, [[5, 10]])  # what came before the first one is not lost
    assert received([1, 4, 5, 6, 8]) == (3, [[1, 8]])


def test_a_publisher_that_was_restarted_has_numbers_of_its_own() -> None:
    assert received([7, 8, 1, 2, 4]) == (1, [[7, 8], [1, 4]])
    assert received([7, 8, 1, 2, 4], publishers=2) == (1, [[7, 8], [1, 4]])


def test_publishers_of_one_topic_are_told_apart_by_their_numbers() -> None:
    one, two = range(1, 40), range(100, 139)
    both = [number for pair in zip(one, two, strict=True) for number in pair]
    assert received(both, publishers=2) == (0, [[1, 39], [100, 138]])
    assert received([n for n in both if n not in (20, 21, 130)], publishers=2)[0] == 3
    same = [number for number in range(1, 40) for _ in range(3)]
    assert received(same, publishers=3)[0] == 0
    del same[60]
    assert received(same, publishers=3)[0] == 1


@given(st.data())
def test_a_loss_is_told_only_where_there_was_one(data: st.DataObject) -> None:
    senders = data.draw(st.lists(st.integers(1, 60), min_size=1, max_size=4))
    order = data.draw(st.permutations([k for k, n in enumerate(senders) for _ in range(n)]))
    lost = data.draw(st.sets(st.integers(0, len(order) - 1)))
    counts, first, last, numbers = Counter[int](), {}, {}, []
    for at, sender in enumerate(order):
        counts[sender] += 1
        if at not in lost:
            numbers.append(counts[sender])
            first.setdefault(sender, counts[sender])
            last[sender] = counts[sender]
    gaps = sum(last[k] - first[k] + 1 for k in first) - len(numbers)
    output_text, _ = received(numbers, publishers=len(senders))
    if gaps == 0 or len(senders) == 1:
        assert output_text == gaps


def test_what_a_latched_publisher_dropped_before_the_first_that_is_heard_is_not_lost() -> None:
    losses = Losses(lambda topic: {b'one'})
    losses.latched.add('/drivers')
    for topic in ('/drivers', '/poses'):
        losses.dropped(topic, 2)
        for number in (41, 42, 43):
            losses.count_message(topic, number)
    assert losses.by_topic() == {'/poses': 2}
    losses.count_message('/drivers', 45)
    assert losses.by_topic()['/drivers'] == 1
    losses.dropped('/drivers', 40)
    assert losses.by_topic()['/drivers'] == 2


def test_what_was_sent_before_the_first_one_heard_is_no_loss_but_told() -> None:
    losses = Losses(lambda topic: {b'one'})
    for number in (4, 5, 1, 2):
        losses.count_message('/a', number)
    losses.count_message('/b', 1)
    assert (losses.by_topic(), losses.earlier()) == ({}, {'/a': 3})


@pytest.mark.parametrize(
    ('stamps', 'lost'),
    [
        ([(1, 10), (2, 20), (5, 20)], 0),  # three more of the same
        ([(1, 10), (4, 20)], 0),  # some of this one, some of the next
        ([(1, 10), (3, 30)], 1),  # a state is missing
        ([(1, 10), (3, 5)], 1),  # another world
        ([(1, 10), (3, None)], 1),
        ([(1, None), (3, 10)], 1),
    ],
)
def test_a_loss_that_only_repeats_what_is_there_leaves_a_bag_whole(
    stamps: list[tuple[int, int | None]], lost: int
) -> None:
    losses = Losses(lambda topic: {b'one'})
    for number, stamp_ns in stamps:
        losses.count_message('/flock/poses', number, stamp_ns, dt_ns=10)
    assert losses.by_topic().total() == lost
    losses.dropped('/flock/poses', stamps[-1][0] - len(stamps))
    assert losses.by_topic().total() == lost  # DDS means the same ones
    assert len(losses.report()) == lost


def test_losses_are_told_by_topic() -> None:
    losses = Losses(lambda topic: {b'one'})
    for number in (1, 2, 5, None):
        losses.count_message('/a', number)
    losses.count_message('/b', 1)
    losses.dropped('/a', 1)
    losses.dropped('/c', 7)
    assert losses.by_topic() == {'/a': 2, '/c': 7}
    assert losses.report() == [
        '/a: 2 missing in the numbering, 1 reported by DDS',
        '/c: 0 missing in the numbering, 7 reported by DDS',
    ]
