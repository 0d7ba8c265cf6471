"""Random numbers: fixed for ever, independent, and the same alone as in a batch."""

from __future__ import annotations

import math

from hypothesis import given, settings
from hypothesis import strategies as st
import pytest
from reference import assert_near, splitmix_bits
from shepherd_ros.sim.rng import (
    direction,
    FIRST_MIXED,
    mixed_seeds,
    normal,
    random_bits,
    Stream,
    uniform,
)
import torch
from torch import Tensor

KINDS = [uniform, normal, direction]
# worked out once with Python's integers and its math module
BITS = [
    [5706694010446104084, 4046795940582026015, -8589536614063798908],
    [-8086385695861922871, 4011317348524380450, 2532241756773850448],
]
UNIFORM = [0.4323310852050781, 0.25659334659576416, 0.8594628572463989]
NORMAL = [-0.4755509382571887, -1.6105801877064334, -0.046550260177099]
DIRECTION = [
    [-0.910966013776058, 0.4124814198784703],
    [-0.04141536980742363, 0.9991420155031587],
    [0.6348199073102601, -0.7726601356887728],
]
LEAST, MOST = -(2**63), 2**63 - 1


def test_mixed_seeds_are_apart_for_every_key_and_the_same_however_many() -> None:
    keys = [
        (seed, group, episode) for seed in range(4) for group in range(4) for episode in (0, 1)
    ]
    seeds = torch.cat([mixed_seeds(1500, *key) for key in keys])
    assert len(seeds.unique()) == len(keys) * 1500
    assert seeds.min() >= FIRST_MIXED  # what is held out has seeds below
    assert seeds.max() < 2 * FIRST_MIXED
    assert torch.equal(mixed_seeds(1500, 1, 2)[:7], mixed_seeds(7, 1, 2))


def one(value: int) -> Tensor:
    return torch.tensor(value, dtype=torch.int64)


def many(kind: object, count: int = 100_000, seed: int = 1, step: int = 2) -> Tensor:
    return kind(one(seed), one(step), Stream.TURN, torch.arange(count), torch.float64)


def correlation(a: Tensor, b: Tensor) -> float:
    return float(torch.corrcoef(torch.stack([a.flatten(), b.flatten()]))[0, 1])


# --- the stream never changes -------------------------------------------------------------------


def test_the_bits_of_all_times() -> None:
    bits = random_bits(torch.tensor([0, 7]), torch.tensor([0, 123]), Stream.GRAZE, torch.arange(3))
    assert bits.tolist() == BITS


def test_the_numbers_of_all_times() -> None:
    at = (one(42), one(10), Stream.CONTROL, torch.arange(3), torch.float64)
    assert_near(uniform(*at), UNIFORM, 1e-12)
    assert_near(normal(*at), NORMAL, 1e-12)
    assert_near(direction(*at), DIRECTION, 1e-12)


def test_the_streams_have_the_numbers_of_all_times() -> None:
    assert {s.name: int(s) for s in Stream} == {
        'FLOCK_PLACE': 1,
        'SHEPHERD_PLACE': 2,
        'SHEEP_POSITION': 3,
        'SHEPHERD_POSITION': 4,
        'HEADING': 5,
        'GOAL_RADIUS': 6,
        'N_SHEPHERDS': 7,
        'GRAZE': 8,
        'TURN': 9,
        'GOAL_NOISE': 10,
        'SHEEP_NOISE': 11,
        'SHEPHERD_NOISE': 12,
        'RANGE_NOISE': 13,
        'DROPOUT': 14,
        'CONTROL': 15,
        'ACTION': 16,
        'GOAL_COURSE': 17,
        'PEDESTRIAN_SPEED': 18,
        'PEDESTRIAN_TARGET': 19,
    }


@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    st.integers(LEAST, MOST),
    st.integers(0, 2**40),
    st.sampled_from(list(Stream)),
    st.integers(0, 2**30),
)
def test_bits_are_those_of_splitmix_in_unbounded_integers(
    seed: int, step: int, stream: Stream, index: int
) -> None:
    result = random_bits(one(seed), one(step), stream, torch.tensor([index]))
    assert int(result) == splitmix_bits(seed, step, int(stream), index)


@pytest.mark.parametrize('seed', [LEAST, LEAST + 1, -1, 0, 1, MOST - 1, MOST])
def test_seeds_at_the_ends_of_the_signed_range_are_as_good_as_any(seed: int) -> None:
    bits = random_bits(one(seed), one(0), Stream.TURN, torch.arange(1000))
    assert bits[:5].tolist() == [splitmix_bits(seed, 0, int(Stream.TURN), k) for k in range(5)]
    numbers = many(uniform, seed=seed)
    assert abs(numbers.mean() - 0.5) < 0.005
    for kind in KINDS:
        assert many(kind, count=1000, seed=seed).isfinite().all()


def test_a_uniform_number_is_the_upper_24_bits() -> None:
    index = torch.arange(50)
    expected = [
        ((splitmix_bits(5, 6, int(Stream.TURN), k) >> 40) & 0xFFFFFF) / 2**24 for k in range(50)
    ]
    assert uniform(one(5), one(6), Stream.TURN, index, torch.float64).tolist() == expected
    assert uniform(one(5), one(6), Stream.TURN, index).double().tolist() == expected


# --- distributions ------------------------------------------------------------------------------


def test_uniform_numbers_are_spread_evenly_over_zero_to_one() -> None:
    numbers = many(uniform)
    assert numbers.min() >= 0.0
    assert numbers.max() < 1.0
    share = torch.histc(numbers, bins=20, min=0, max=1) / len(numbers)
    assert (share - 0.05).abs().max() < 0.004  # more than five standard deviations
    assert abs(numbers.mean() - 0.5) < 0.005
    assert abs(numbers.var() - 1 / 12) < 0.002


def test_normal_numbers_have_the_moments_and_tails_of_a_normal_distribution() -> None:
    numbers = many(normal)
    assert abs(numbers.mean()) < 0.02
    assert abs(numbers.std() - 1) < 0.02
    assert abs((numbers**3).mean()) < 0.06
    assert abs((numbers**4).mean() - 3) < 0.15
    for bound, share in ((1.0, 0.6827), (2.0, 0.9545), (3.0, 0.9973)):
        assert abs((numbers.abs() < bound).double().mean() - share) < 0.008
    assert numbers.abs().max() < 6.0


def test_directions_are_unit_vectors_all_round() -> None:
    directions = many(direction)
    assert_near(directions.norm(dim=-1), torch.ones(len(directions)), 1e-12)
    assert directions.mean(dim=0).abs().max() < 0.02
    angle = torch.atan2(directions[:, 1], directions[:, 0])
    share = torch.histc(angle, bins=16, min=-math.pi, max=math.pi) / len(angle)
    assert (share - 1 / 16).abs().max() < 0.005


def test_float32_draws_are_the_rounded_float64_draws() -> None:
    index = torch.arange(10_000)
    for kind in KINDS:
        single = kind(one(3), one(4), Stream.ACTION, index)
        double = kind(one(3), one(4), Stream.ACTION, index, torch.float64)
        assert single.dtype == torch.float32
        assert_near(single.double(), double, 1e-5)


# --- independence -------------------------------------------------------------------------------


@pytest.mark.parametrize('kind', [uniform, normal], ids=['uniform', 'normal'])
def test_neighbours_in_seed_step_stream_and_index_are_independent(kind: object) -> None:
    index = torch.arange(50_000)
    here = kind(one(100), one(50), Stream.GRAZE, index, torch.float64)
    others = {
        'seed': kind(one(101), one(50), Stream.GRAZE, index, torch.float64),
        'step': kind(one(100), one(51), Stream.GRAZE, index, torch.float64),
        'stream': kind(one(100), one(50), Stream.TURN, index, torch.float64),
        'index': kind(one(100), one(50), Stream.GRAZE, index + 1, torch.float64),
        'seed and step': kind(one(101), one(49), Stream.GRAZE, index, torch.float64),
    }
    for name, numbers in others.items():
        assert abs(correlation(here, numbers)) < 0.025, name


def test_the_first_numbers_of_many_seeds_and_of_many_steps_are_uniform() -> None:
    for seed, step in (
        (torch.arange(50_000), torch.zeros(50_000, dtype=torch.int64)),
        (torch.zeros(50_000, dtype=torch.int64), torch.arange(50_000)),
        (torch.arange(50_000), torch.arange(50_000)),
    ):
        numbers = uniform(seed, step, Stream.FLOCK_PLACE, torch.arange(1), torch.float64)[:, 0]
        share = torch.histc(numbers, bins=10, min=0, max=1) / len(numbers)
        assert (share - 0.1).abs().max() < 0.008
        assert abs(correlation(numbers[1:], numbers[:-1])) < 0.025


def test_no_two_draws_share_their_bits() -> None:
    seeds, steps = torch.arange(-20, 20)[:, None], torch.arange(50)
    seed, step = torch.broadcast_tensors(seeds, steps)
    bits = [random_bits(seed, step, stream, torch.arange(10)) for stream in Stream]
    assert torch.stack(bits).unique().numel() == 40 * 50 * 10 * len(Stream)


# --- batches ------------------------------------------------------------------------------------


@pytest.mark.parametrize('kind', KINDS, ids=lambda k: k.__name__)
def test_a_draw_is_the_same_alone_and_in_any_batch_and_order(kind: object) -> None:
    seed, step = torch.tensor([[1, 2, 3], [4, 5, 6]]), torch.tensor([[7, 8, 9], [1, 1, 2]])
    index = torch.tensor([[5, 0, 2], [1, 9, 4]])
    together = kind(seed, step, Stream.TURN, index)
    assert together.shape == (2, 3, 2, 3) + ((2,) if kind is direction else ())
    for i in range(2):
        for j in range(3):
            alone = kind(seed[i, j], step[i, j], Stream.TURN, torch.arange(10))
            assert torch.equal(together[i, j], alone[index])


def test_drawing_twice_gives_the_same() -> None:
    assert torch.equal(many(normal), many(normal))
