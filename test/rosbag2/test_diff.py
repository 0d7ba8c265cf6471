"""The first difference of two decoded values, by hand."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from rosbag2.tiny import cdr, make, Sent
from shepherd_ros.rosbag2.bag import BagMessage
from shepherd_ros.rosbag2.diff import differences, TopicDiff, without_repeats


@dataclass
class Pair:
    """A message of two fields."""

    x: Any = 0.0
    rows: Any = field(default_factory=list)


@pytest.mark.parametrize(
    ('left', 'right', 'places'),
    [
        (1.0, 1.0, []),
        (nan, nan, []),
        (1.0, nan, [': 1.0 and nan']),
        (nan, 1.0, [': nan and 1.0']),
        (-inf, inf, [': -inf and inf']),
        (2.0, 1.0, [': 2.0 and 1.0']),
        ('a', 'b', [": 'a' and 'b'"]),
        ('ab', 'ab', []),
        ([1, 2], 1, [': 2 and 1 entries']),
        ([1, 2], [1], [': 2 and 1 entries']),
        ([], [], []),
        ([1, 2, 3], [0, 2, 4], ['[0]: 1 and 0', '[2]: 3 and 4']),
        (Pair(1.0, [Pair(nan)]), Pair(1.0, [Pair(nan)]), []),
        (Pair(1.0, [Pair(), Pair(2)]), Pair(3.0, [Pair(), Pair(nan)]),
         ['x: 1.0 and 3.0', 'rows[1].x: 2 and nan']),
        (np.array([1.0, nan]), np.array([1.0, nan]), []),
        (np.array([nan, 1.0, 2.0]), np.array([nan, nan, 2.0]), ['[1]: 1.0 and nan']),
        (np.array([nan, nan, 2.0]), np.array([nan, 1.0, 2.0]), ['[1]: nan and 1.0']),
        (np.array([nan, 1.0, 3.0]), np.array([nan, 1.0, 2.0]), ['[2]: 3.0 and 2.0']),
        (np.array([1, 2, 3]), np.array([1, 3, 2]), ['[1]: 2 and 3']),
        (np.array([True, False]), np.array([True, True]), ['[1]: False and True']),
        (np.array([1, 2]), np.array([1]), [': 2 and 1 entries']),
        (np.array(['a', 'b']), np.array(['a', 'c']), ["[1]: 'b' and 'c'"]),
    ],
)  # fmt: skip
def test_each_difference_is_named_with_its_place(left: Any, right: Any, places: list[str]) -> None:
    found = [text.replace('np.str_', '').replace('(', '').replace(')', '')
             for text in differences(left, right)]  # fmt: skip
    assert found == places


def test_a_topic_is_equal_if_counts_and_contents_are() -> None:
    assert str(TopicDiff('/a', 3, 3)) == '/a: 3 equal messages'
    assert TopicDiff('/a', 1000, int('1000')).equal
    assert str(TopicDiff('/a', 3, 2)) == '/a: 3 and 2 messages'
    assert (
        str(TopicDiff('/a', 3, 3, 0, 'x: 1 and 2')) == '/a: 3 and 3 messages; number 0: x: 1 and 2'
    )
    assert [TopicDiff('/a', 3, right, index).equal for right, index in
            ((3, None), (2, None), (3, 0))] == [True, False, False]  # fmt: skip


def test_repeats_are_those_of_the_message_before_on_the_same_topic() -> None:
    texts = [('/a', 'x'), ('/a', 'x'), ('/b', 'x'), ('/a', 'y'), ('/a', 'x'), ('/b', 'x')]
    rows = [
        Sent(topic, 'S', cdr(make('String', data=text)) + bytes(k % 3), k, k)
        for k, (topic, text) in enumerate(texts)
    ]
    messages = [BagMessage(m.topic, m.type, m.log_ns, m.publish_ns, m.data) for m in rows]
    assert [m.log_ns for m in without_repeats(messages)] == [0, 2, 3, 4]
