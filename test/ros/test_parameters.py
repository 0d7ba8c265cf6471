"""Parameters of nodes are checked in words, and described with their range."""

from __future__ import annotations

import math
from typing import Any

import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.ros.parameters import checked, descriptor


@pytest.mark.parametrize(
    ('value', 'default', 'limits', 'expected'),
    [
        (20, 0.5, {}, 20.0),  # an integer is taken where a float is expected
        (0.25, 0.5, {}, 0.25),
        (7, 3, {}, 7),
        (True, False, {}, True),
        ('b', 'a', {'choices': ('a', 'b')}, 'b'),
        ([1, 2], [0], {}, [1, 2]),
        (1, 0.5, {'low': 1, 'high': 1}, 1.0),
    ],
)
def test_a_good_parameter_is_taken_in_the_type_of_its_default(
    value: Any, default: Any, limits: dict[str, Any], expected: Any
) -> None:
    result = checked('x', value, default, limits)
    assert result == expected
    assert type(result) is type(default)


@pytest.mark.parametrize(
    ('value', 'default', 'limits', 'pattern'),
    [
        (True, 0.5, {}, r'x is True \(bool\): expected float, such as 0.5'),
        (True, 3, {}, r'x is True \(bool\): expected int, such as 3'),
        (1, False, {}, r'x is 1 \(int\): expected bool, such as False'),
        (2.0, 3, {}, r'x is 2.0 \(float\): expected int, such as 3'),
        ('2', 0.5, {}, r"x is '2' \(str\): expected float, such as 0.5"),
        (5, 'a', {}, r'x is 5 \(int\): expected str'),
        (5, [0], {}, r'x is 5 \(int\): expected list, such as \[0\]'),
        (math.nan, 0.5, {}, 'x is nan: expected a finite number, such as 0.5'),
        (-math.inf, 0.5, {}, 'x is -inf: expected a finite number'),
        (0, 3, {'low': 1}, r'x is 0: expected a value in \[1, inf\], such as 3'),
        (2, 0.5, {'high': 1.0}, r'x is 2.0: expected a value in \[-inf, 1.0\]'),
        ('c', 'a', {'choices': ('a', 'b')}, "x is 'c': expected one of a, b"),
        ('alphb', 'alpha', {'choices': ('alpha', 'z')}, "did you mean 'alpha'"),
    ],
)
def test_a_bad_parameter_is_refused_with_value_expectation_and_example(
    value: Any, default: Any, limits: dict[str, Any], pattern: str
) -> None:
    with pytest.raises(ConfigError, match=pattern):
        checked('x', value, default, limits)


def test_a_descriptor_has_the_range_on_both_sides_even_if_only_one_is_given() -> None:
    described = descriptor(0.5, {'doc': 'a share', 'low': 0.0}, read_only=True)
    (interval,) = described.floating_point_range
    assert (interval.from_value, interval.step) == (0.0, 0.0)
    assert interval.to_value >= 1e9
    assert described.description == 'a share'
    assert described.read_only
    described = descriptor(3, {'doc': 'a count', 'low': 1, 'high': 9}, read_only=False)
    (interval,) = described.integer_range
    assert (interval.from_value, interval.to_value, interval.step) == (1, 9, 0)
    assert not described.read_only
    described = descriptor('a', {'doc': 'a name', 'choices': ('a', 'b')}, read_only=True)
    assert 'a, b' in described.additional_constraints
    assert not described.integer_range
    assert not described.floating_point_range
