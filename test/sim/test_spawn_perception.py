"""Starts of episodes, perception of the world, and worlds as batches."""

from __future__ import annotations

from dataclasses import replace
import math

import pytest
from reference import assert_near, assert_same_world, batch, make_state, padded, state_of
from shepherd_ros.sim.flocking.reynolds_flock import ReynoldsFlock
from shepherd_ros.sim.perception import perceive
from shepherd_ros.sim.presets import home_world, training_world
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import stack, where, WorldState
from shepherd_ros.sim.vectors import bearing, clip_norm, from_bearing, masked_mean, unit, wrap
from shepherd_ros.sim.world import SpawnConfig, WorldConfig
import torch
from torch import Tensor

TIGHT = SpawnConfig(position_std=0.0)


def starts(config: WorldConfig, count: int = 4000) -> WorldState:
    return spawn(config, torch.arange(count), torch.float64)


def is_even_all_round(vector: Tensor) -> bool:
    share = torch.histc(bearing(vector), bins=8, min=-math.pi, max=math.pi) / len(vector)
    return bool((share - 1 / 8).abs().max() < 0.03)


# --- spawn --------------------------------------------------------------------------------------


def test_the_flock_starts_ten_to_twenty_meters_from_the_goal_in_any_direction() -> None:
    state = starts(WorldConfig(n_sheep=2, spawn=TIGHT))
    assert torch.equal(state.goal, torch.zeros(4000, 2))
    distance = state.center.norm(dim=-1)
    assert distance.min() >= 10.0 - 1e-9
    assert distance.max() <= 20.0
    share = torch.histc(distance, bins=5, min=10, max=20) / 4000
    assert (share - 0.2).abs().max() < 0.04
    assert is_even_all_round(state.center)


def test_the_shepherds_start_five_to_ten_meters_from_the_flock_in_any_direction() -> None:
    state = starts(WorldConfig(n_sheep=2, n_shepherds=3, spawn=TIGHT))
    offset = state.shepherds[:, 0] - state.center
    distance = offset.norm(dim=-1)
    assert distance.min() >= 5.0 - 1e-9
    assert distance.max() <= 10.0
    share = torch.histc(distance, bins=5, min=5, max=10) / 4000
    assert (share - 0.2).abs().max() < 0.04
    assert is_even_all_round(offset)
    relative = torch.atan2(offset[:, 1], offset[:, 0]) - bearing(state.center)
    assert wrap(relative).mean().abs() < 0.15  # independent of where the flock is


def test_shepherds_all_around_have_a_direction_and_a_distance_each() -> None:
    around = replace(TIGHT, shepherds_around=True)
    state = starts(WorldConfig(n_sheep=2, n_shepherds=3, spawn=around))
    together = starts(WorldConfig(n_sheep=2, n_shepherds=3, spawn=TIGHT))
    assert torch.equal(state.sheep, together.sheep)
    assert torch.equal(state.shepherds[:, 0], together.shepherds[:, 0])
    offset = state.shepherds - state.center[:, None]
    distance = offset.norm(dim=-1)
    assert 5.0 - 1e-9 <= distance.min() <= distance.max() <= 10.0
    between = wrap(bearing(offset[:, 1:]) - bearing(offset[:, :1]))
    for k in range(2):
        assert is_even_all_round(offset[:, k + 1])
        assert is_even_all_round(from_bearing(between[:, k]))
    assert torch.corrcoef(distance.T)[0, 1:].abs().max() < 0.06


def test_a_start_at_home_has_the_flock_in_the_goal_and_shepherds_on_all_sides() -> None:
    world = home_world(WorldConfig(n_sheep=100, n_shepherds=3))
    state = starts(world, 400)
    assert state.center.norm(dim=-1).max() < 3.0
    inside = (state.sheep.norm(dim=-1) < 4.0).double().mean()
    assert 0.6 < inside < 0.9  # strays have to be fetched
    offset = state.shepherds - state.center[:, None]
    between = wrap(bearing(offset[:, 1]) - bearing(offset[:, 0]))
    assert (between.abs() > math.pi / 2).double().mean() == pytest.approx(0.5, abs=0.08)


def test_a_flock_in_groups_has_a_center_for_each_and_the_first_is_that_of_a_whole_one() -> None:
    whole = starts(WorldConfig(n_sheep=6, spawn=TIGHT))
    split_name = starts(WorldConfig(n_sheep=6, spawn=replace(TIGHT, flock_groups=2)))
    assert torch.equal(split_name.sheep[:, ::2], whole.sheep[:, ::2])
    assert torch.equal(split_name.shepherds, whole.shepherds)
    other = split_name.sheep[:, 1::2]
    assert torch.equal(other, other[:, :1].expand_as(other))
    distance = other[:, 0].norm(dim=-1)
    assert 10.0 - 1e-9 <= distance.min() <= distance.max() <= 20.0
    turn = wrap(bearing(other[:, 0]) - bearing(whole.center))
    assert is_even_all_round(from_bearing(turn))


def test_everyone_starts_a_normal_distance_from_the_group_in_any_direction() -> None:
    config = WorldConfig(n_sheep=10, n_shepherds=5, spawn=SpawnConfig(position_std=2.0))
    state, middle = starts(config), starts(replace(config, spawn=TIGHT))
    for here, center in (
        (state.sheep, middle.sheep[:, :1]),
        (state.shepherds, middle.shepherds[:, :1]),
    ):
        offset = (here - center).flatten(0, 1)
        distance = offset.norm(dim=-1)
        assert abs((distance**2).mean() - 4.0) < 0.15
        assert abs((distance < 2.0).double().mean() - 0.6827) < 0.015
        assert is_even_all_round(offset)
        octant = (bearing(offset) / (math.pi / 4)).floor()
        for k in range(-4, 4):  # near and far in all directions alike
            assert abs((distance[octant == k] ** 2).mean() - 4.0) < 0.6
        neighbours = (here - center)[:, 1:], (here - center)[:, :-1]
        assert (neighbours[0] * neighbours[1]).mean().abs() < 0.1  # independent of each other


def test_without_a_range_the_goal_and_the_team_are_always_the_same() -> None:
    state = starts(WorldConfig(n_shepherds=4, goal_radius=3.0, n_sheep=1), 100)
    assert_near(state.goal_radius, torch.full((100,), 3.0), 0.0)
    assert state.shepherd_mask.all()
    assert state.sheep_mask.all()


def test_training_draws_goals_of_four_to_eight_meters_and_teams_of_one_to_six() -> None:
    config = replace(training_world(WorldConfig()), n_sheep=1)
    state = starts(config)
    assert state.goal_radius.min() >= 4.0
    assert state.goal_radius.max() < 8.0
    share = torch.histc(state.goal_radius, bins=4, min=4, max=8) / 4000
    assert (share - 0.25).abs().max() < 0.04
    size = torch.bincount(state.team_size, minlength=7)
    assert size[0] == 0
    assert (size[1:] / 4000 - 1 / 6).abs().max() < 0.03
    together = torch.corrcoef(torch.stack([state.goal_radius, state.team_size.double()]))
    assert abs(together[0, 1]) < 0.08


def test_absent_shepherds_come_last_and_stand_on_the_goal() -> None:
    state = starts(replace(training_world(WorldConfig()), n_sheep=1), 200)
    present = state.shepherd_mask
    assert (present[:, :-1] >= present[:, 1:]).all()
    assert present.any(dim=-1).all()
    assert (state.shepherds[~present] == 0).all()


@pytest.mark.parametrize('flock', [None, ReynoldsFlock()], ids=['strombom', 'reynolds'])
def test_an_episode_starts_the_same_alone_and_among_others(flock: object) -> None:
    config = training_world(WorldConfig() if flock is None else WorldConfig(flock=flock))
    seeds = torch.tensor([[3, -5, 0], [2**62, -(2**63), 2**63 - 1]])
    together = spawn(config, seeds)
    for i in range(2):
        for j in range(3):
            assert_same_world(together.world(i).world(j), spawn(config, seeds[i, j]))


def test_a_start_is_at_step_zero_with_unit_headings_in_float32() -> None:
    small = spawn(WorldConfig(n_sheep=5, n_shepherds=2), torch.tensor(7))
    assert int(small.step) == 0
    assert int(small.seed) == 7
    assert small.sheep.dtype == small.heading.dtype == torch.float32
    assert small.sheep.shape == small.heading.shape == (5, 2)
    assert_near(small.heading.norm(dim=-1), torch.ones(5), 1e-6)


def test_seeds_make_starts_and_the_same_seed_the_same_start() -> None:
    config = WorldConfig(n_sheep=5)
    a, b = spawn(config, torch.tensor(1)), spawn(config, torch.tensor(2))
    assert_same_world(a, spawn(config, torch.tensor(1)))
    assert (a.center - b.center).norm() > 0.1


def test_a_start_in_float32_is_the_rounded_start_in_float64() -> None:
    config = training_world(WorldConfig())
    single, double = (spawn(config, torch.arange(5), t) for t in (torch.float32, torch.float64))
    assert_near(single.sheep.double(), double.sheep, 2e-6)
    assert_near(single.shepherds.double(), double.shepherds, 2e-6)
    assert torch.equal(single.shepherd_mask, double.shepherd_mask)


# --- perception ---------------------------------------------------------------------------------


def test_without_noise_the_world_is_seen_as_it_is() -> None:
    state = make_state(1, 10, 3)
    assert_same_world(perceive(state, 0.0), state)


def test_perceived_positions_have_independent_normal_noise_on_each_coordinate() -> None:
    state = batch([replace(make_state(1, 100, 20), seed=torch.tensor(k)) for k in range(200)])
    seen = perceive(state, 0.7)
    for name in ('sheep', 'shepherds', 'goal'):
        error = (getattr(seen, name) - getattr(state, name)).reshape(-1, 2) / 0.7
        bound = 5 / math.sqrt(len(error))
        assert error.mean(dim=0).abs().max() < bound
        assert (error.std(dim=0) - 1).abs().max() < bound
        assert abs((error.abs() < 1).double().mean() - 0.6827) < bound
        assert (error[:, 0] * error[:, 1]).mean().abs() < bound
        assert (error[1:] * error[:-1]).mean(dim=0).abs().max() < bound


def test_noise_of_sheep_shepherds_and_goal_is_independent() -> None:
    state = batch([replace(make_state(1, 20, 20), seed=torch.tensor(k)) for k in range(200)])
    seen = perceive(state, 1.0)
    sheep, shepherds = seen.sheep - state.sheep, seen.shepherds - state.shepherds
    goal = (seen.goal - state.goal)[:, None].expand_as(sheep)
    for a, b in ((sheep, shepherds), (sheep, goal), (shepherds, goal)):
        assert (a * b)[:, 0].mean().abs() < 0.3
    assert (sheep * shepherds).mean().abs() < 0.06


def test_noise_leaves_headings_masks_time_and_goal_size_alone() -> None:
    state = padded(make_state(1, 10, 3), 2, 1)
    seen = perceive(state, 1.0)
    for name in ('heading', 'sheep_mask', 'shepherd_mask', 'seed', 'step', 'goal_radius'):
        assert torch.equal(getattr(seen, name), getattr(state, name))


def test_noise_is_drawn_anew_each_step_and_for_each_seed_but_not_each_time() -> None:
    state = make_state(1, 10, 3)
    here = perceive(state, 1.0)
    assert_same_world(here, perceive(state, 1.0))
    for other in (replace(state, step=state.step + 1), replace(state, seed=state.seed + 1)):
        assert (perceive(other, 1.0).sheep - here.sheep).abs().max() > 0.1
        assert (perceive(other, 1.0).goal - here.goal).abs().max() > 1e-3


def test_noise_grows_in_proportion() -> None:
    state = make_state(1, 10, 3)
    once, twice = perceive(state, 0.5), perceive(state, 1.0)
    assert_near(twice.sheep - state.sheep, 2 * (once.sheep - state.sheep), 1e-9)


def test_a_perceived_batch_is_each_perceived_world_bit_for_bit() -> None:
    for dtype in (torch.float32, torch.float64):
        states = [make_state(k, 20, 3, dtype=dtype) for k in range(4)]
        together = perceive(batch(states), 0.5)
        for index, state in enumerate(states):
            assert_same_world(together.world(index), perceive(state, 0.5))


def test_who_is_absent_changes_no_noise_of_those_present() -> None:
    state = make_state(1, 10, 3)
    seen, with_absent = perceive(state, 0.5), perceive(padded(state, 5, 2), 0.5)
    assert_near(with_absent.sheep[:10], seen.sheep, 1e-12)
    assert_near(with_absent.shepherds[:3], seen.shepherds, 1e-12)
    assert_near(with_absent.goal, seen.goal, 1e-12)


# --- states -------------------------------------------------------------------------------------


def test_center_and_sizes_count_those_present_only() -> None:
    state = padded(state_of([[1.0, 2.0], [3.0, 6.0]], [[9.0, 9.0]], goal=[50.0, 0.0]), 3, 4)
    assert_near(state.center, [2.0, 4.0], 1e-12)
    assert int(state.flock_size) == 2
    assert int(state.team_size) == 1


def test_worlds_are_stacked_picked_and_chosen_between() -> None:
    a, b, c = (make_state(k, 4, 2) for k in range(3))
    left, right = stack([a, b]), stack([c, c])
    assert_same_world(left.world(1), b)
    assert_same_world(left.world(slice(0, 1)).world(0), a)
    mixed = where(torch.tensor([False, True]), left, right)
    assert_same_world(mixed.world(0), c)
    assert_same_world(mixed.world(1), b)


def test_changing_the_precision_leaves_integers_and_masks_alone() -> None:
    state = make_state(1, 4, 2).to(torch.float32)
    assert state.sheep.dtype == state.goal_radius.dtype == torch.float32
    assert state.seed.dtype == state.step.dtype == torch.int64
    assert state.sheep_mask.dtype == torch.bool


# --- vectors ------------------------------------------------------------------------------------


def test_vectors_by_hand() -> None:
    double = torch.float64
    vectors = torch.tensor([[3.0, 4.0], [0.0, 0.0], [0.0, -2.0]], dtype=double)
    assert_near(unit(vectors), [[0.6, 0.8], [0.0, 0.0], [0.0, -1.0]], 1e-12)
    assert_near(clip_norm(vectors, 2.5), [[1.5, 2.0], [0.0, 0.0], [0.0, -2.0]], 1e-12)
    assert_near(clip_norm(vectors, 0.0), torch.zeros(3, 2), 0.0)
    assert_near(bearing(vectors[[0, 2]]), [math.atan2(4, 3), -math.pi / 2], 1e-12)
    angle = torch.tensor([0.0, math.pi / 2, 3.0], dtype=double)
    assert_near(from_bearing(angle)[:2], [[1.0, 0.0], [0.0, 1.0]], 1e-12)
    assert_near(bearing(from_bearing(angle)), angle, 1e-12)
    assert_near(wrap(angle + 8 * math.pi), angle, 1e-12)
    assert_near(
        wrap(torch.tensor([4.0, -4.0], dtype=double)), [4 - 2 * math.pi, 2 * math.pi - 4], 1e-12
    )
    half_turns = torch.tensor([math.pi, -math.pi], dtype=double)
    assert_near(wrap(half_turns), [-math.pi, -math.pi], 1e-12)
    short = torch.tensor([[1e-6, 0.0], [0.0, 0.99e-6]], dtype=double)  # the second is none
    assert_near(unit(short), [[1.0, 0.0], [0.0, 0.0]], 1e-12)
    long = torch.full((2,), 2e38)  # its square is no float32
    assert_near(clip_norm(long, 1.0), [0.5**0.5, 0.5**0.5], 1e-6)
    mask = torch.tensor([True, False, True])
    assert_near(masked_mean(vectors, mask), [1.5, 1.0], 1e-12)
    assert_near(masked_mean(vectors, mask & False), [0.0, 0.0], 0.0)
