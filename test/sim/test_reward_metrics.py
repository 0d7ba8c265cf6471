"""Reward terms and metrics: by hand on tiny flocks, and against the slow reference."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, product
import math

from reference import (
    assert_near,
    batch,
    make_state,
    padded,
    reward,
    state_of,
    trajectory_metrics,
    World,
)
from shepherd_ros.sim.flocking.reynolds_flock import ReynoldsFlock
from shepherd_ros.sim.flocking.strombom_flock import StrombomFlock
from shepherd_ros.sim.metrics import (
    count_step,
    METRICS,
    metrics,
    MetricsTally,
    PAPER_METRICS,
    shown,
    start_tally,
)
from shepherd_ros.sim.reward import reward_terms, RewardConfig
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.tally import flock_spread
from shepherd_ros.sim.transition import step
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor

# --- reward -------------------------------------------------------------------------------------


def test_all_in_earns_the_whole_occupancy_of_a_step_and_no_shaping() -> None:
    terms = reward_terms(state_of([[1.0, 0.0], [0.0, -4.0]], [[9.0, 9.0]]), RewardConfig(), 1000)
    assert_near(terms['occupancy'], 0.01, 1e-12)
    assert_near(terms['shaping'], 0.0, 0.0)


def test_one_in_and_two_out_by_hand() -> None:
    # 3-4-5 triangle: 1 m beyond the rim; 8-6-10: 6 m beyond
    state = state_of([[0.0, 1.0], [3.0, 4.0], [-8.0, 6.0]], [[9.0, 9.0]])
    assert_near(state.gap, [-3.0, 1.0, 6.0], 1e-12)
    terms = reward_terms(state, RewardConfig(), 100)
    assert set(terms) == {'occupancy', 'shaping'}
    assert_near(terms['occupancy'], 10 * 1 / 300, 1e-12)
    assert_near(terms['shaping'], -0.1 * ((1 + 1) + (1 + 6)) / 300, 1e-12)
    once = reward_terms(state, RewardConfig(one_per_step=True), 100)
    assert_near(once['shaping'], -0.1 * (1 + 1 + 6) / 300, 1e-12)


def test_a_flock_fifteen_meters_outside_costs_as_the_design_says() -> None:
    state = state_of([[19.0, 0.0]] * 100, [[9.0, 9.0]])
    assert_near(sum(reward_terms(state, RewardConfig(), 1000).values()), -0.0016, 1e-12)


def test_a_sheep_on_the_rim_is_in() -> None:
    terms = reward_terms(state_of([[4.0, 0.0]], [[9.0, 9.0]]), RewardConfig(), 1)
    assert_near(terms['occupancy'], 10.0, 0.0)
    assert_near(terms['shaping'], 0.0, 0.0)


def test_reward_terms_are_those_of_the_reference() -> None:
    for one_per_step, n in product([False, True], [1, 2, 10, 100, 1000]):
        config = RewardConfig(occupancy=7.0, shaping=-0.3, one_per_step=one_per_step)
        for seed in range(5):
            state = make_state(seed, n, 2, spread=10.0, goal_radius=3.0 * (1 + 2 * seed))
            expected = reward(World.of(state), config, 500)
            for dtype, tolerance in ((torch.float64, 1e-8), (torch.float32, 1e-6)):
                terms = reward_terms(state.to(dtype), config, 500)
                for name, value in expected.items():
                    assert_near(terms[name].double(), value, tolerance)


def test_absent_sheep_earn_nothing_although_they_stand_on_the_goal() -> None:
    state = make_state(2, 10, 2)
    for one_per_step in (False, True):
        config = RewardConfig(one_per_step=one_per_step)
        expected = reward_terms(state, config, 100)
        result = reward_terms(padded(state, 5, 3), config, 100)
        for name in expected:
            assert_near(result[name], expected[name], 1e-12)


def test_rewards_of_a_batch_are_those_of_each_world() -> None:
    states = [make_state(n, n, 2, spread=10.0) for n in (1, 5, 40)]
    together = reward_terms(batch(states), RewardConfig(), 100)
    for index, state in enumerate(states):
        for name, value in reward_terms(state, RewardConfig(), 100).items():
            assert_near(together[name][index], value, 1e-12)


# --- metrics by hand ----------------------------------------------------------------------------


def tell(
    states: list[WorldState], episode_steps: int = 100
) -> tuple[dict[str, Tensor], MetricsTally]:
    """Return the metrics of a trajectory, counted step by step."""
    tally = start_tally(states[0])
    for before, after in pairwise(states):
        tally = count_step(tally, before, after)
    return metrics(tally, states[-1], episode_steps), tally


def two_sheep_walk() -> list[WorldState]:
    """Return two sheep 2 m apart that walk to the goal in steps of 3 m, past a shepherd pair."""
    return [
        state_of(
            [[x, 1.0], [x, -1.0]],
            [[x + 5.0, 0.0], [20.0, 4.0 * t]],
            goal=[0.0, 0.0],
            goal_radius=2.0,
            step=t,
        )
        for t, x in enumerate([7.0, 4.0, 1.0, 4.0])
    ]


def test_the_metrics_of_a_walk_into_the_goal_and_out_again_by_hand() -> None:
    result, _ = tell(two_sheep_walk())
    expected = {
        'completion_time': 2,  # center 7, 4, 1, 4 m from the goal of 2 m
        'shepherd_path_length': (3 * 3 + 3 * 4) / 2,
        'flock_path_length': 9,
        'flock_spread': 1,
        'fraction_reached': 1,  # at step 2 both were sqrt(2) m from the goal's center
        'completed': 1,
        'shepherd_path_to_completion': (2 * 3 + 2 * 4) / 2,
        'flock_path_to_completion': 6,
        'flock_spread_per_axis': 0.5,
        'flock_spread_at_completion': 1,
        'fraction_in_goal': 0,
        'goal_distance': 4,
    }
    assert list(result) == list(METRICS) == list(expected)
    for name, value in expected.items():
        assert_near(result[name].double(), value, 1e-12)


def test_without_completion_the_time_is_that_of_the_whole_episode_and_paths_run_on() -> None:
    result, _ = tell(two_sheep_walk()[:2], episode_steps=77)
    assert result['completion_time'] == 77
    assert result['completed'] == 0
    assert result['fraction_reached'] == 0
    assert_near(result['flock_path_to_completion'], 3, 1e-12)
    assert_near(result['shepherd_path_to_completion'], 3.5, 1e-12)


def test_a_flock_that_starts_in_the_goal_completes_at_step_zero() -> None:
    states = [state_of([[x, 0.0]], [[9.0, 0.0]], step=t) for t, x in enumerate([1.0, 6.0])]
    result, _ = tell(states)
    assert result['completion_time'] == 0
    assert result['completed'] == 1
    assert result['flock_path_to_completion'] == 0
    assert_near(result['flock_path_length'], 5, 1e-12)
    assert result['fraction_reached'] == 1
    assert result['fraction_in_goal'] == 0


def test_the_spread_of_a_square_is_its_half_diagonal() -> None:
    state = state_of([[1.0, 3.0], [1.0, -3.0], [-1.0, 3.0], [-1.0, -3.0]], [[9.0, 0.0]])
    spread, per_axis = flock_spread(state)
    assert_near(spread, 10**0.5, 1e-12)
    assert_near(per_axis, 2.0, 1e-12)


def test_the_mean_spread_is_over_steps_and_not_over_the_first_state() -> None:
    states = [
        state_of([[30.0 + s, 0.0], [30.0 - s, 0.0]], [[9.0, 0.0]], step=t)
        for t, s in enumerate([100.0, 1.0, 3.0])
    ]
    result, _ = tell(states)
    assert_near(result['flock_spread'], 2.0, 1e-12)
    assert_near(result['flock_spread_per_axis'], 1.0, 1e-12)
    assert_near(result['flock_spread_at_completion'], 3.0, 1e-12)
    first, _ = tell(states[:1])
    assert_near(first['flock_spread'], 100.0, 1e-12)


def test_a_center_exactly_on_the_rim_is_in_the_goal() -> None:
    result, _ = tell([state_of([[4.0, 0.0]], [[9.0, 0.0]])])
    assert result['completed'] == 1
    assert result['fraction_reached'] == 1
    assert result['fraction_in_goal'] == 1


def test_each_place_shows_its_metrics_in_their_order() -> None:
    home = ['completion_time', 'shepherd_path_length', 'flock_path_length', 'flock_spread']
    expected = {
        'summary': [*home, 'fraction_reached', 'fraction_in_goal', 'shepherd_path_to_completion'],
        'eval': ['completed', 'completion_time', 'fraction_reached', 'fraction_in_goal',
                 'shepherd_path_length', 'flock_spread'],
        'progress': ['fraction_reached', 'fraction_in_goal'],
        'bag': [*home, 'fraction_reached', 'fraction_in_goal'],
        'page': ['fraction_in_goal', 'goal_distance', 'flock_spread'],
    }  # fmt: skip
    for place, names in expected.items():
        metrics_there = shown(place)
        assert [metric.name for metric in metrics_there] == names, place
        order = [metric.shown[place] for metric in metrics_there]
        assert order == [*range(order[0], order[0] + len(names))]  # without gaps or draws
    assert {m.name for m in METRICS.values() if m.instant} == {'fraction_in_goal', 'goal_distance'}


def test_the_metrics_of_the_paper_come_first() -> None:
    assert PAPER_METRICS == (
        'completion_time',
        'shepherd_path_length',
        'flock_path_length',
        'flock_spread',
        'fraction_reached',
    )


# --- metrics against the reference --------------------------------------------------------------


def trajectory(seed: int, n: int, m: int, steps: int) -> list[WorldState]:
    """Return a flock that is blown across the goal with its shepherds around it."""
    flock = ReynoldsFlock(speed=1.0) if seed % 2 else StrombomFlock(speed=1.0, noise=0.5)
    config = WorldConfig(flock=flock, dt=1.0)
    state = make_state(seed, n, m, spread=2.0, reach=6.0, goal_radius=3.0)
    state = replace(state, goal=state.center + torch.tensor([2.5 + 2 * (seed % 3), 0.0]))
    states = [state]
    for t in range(steps):
        turn = torch.linspace(0, 2 * math.pi, m + 1, dtype=torch.float64)[:-1] + 0.1 * t
        command = torch.stack([torch.cos(turn), torch.sin(turn)], -1) * 1.2
        states.append(step(states[-1], command, config))
    return states


def test_metrics_are_those_of_the_whole_trajectory() -> None:
    for (n, m, steps), seed in product(
        [(1, 1, 30), (2, 3, 30), (10, 2, 40), (100, 6, 20), (1000, 3, 4)], range(4)
    ):
        states = trajectory(seed, n, m, steps)
        expected = trajectory_metrics([World.of(s) for s in states], 500)
        assert set(expected) == set(METRICS)
        result, _ = tell(states, 500)
        single, _ = tell([s.to(torch.float32) for s in states], 500)
        for name, value in expected.items():
            assert_near(result[name].double(), value, 1e-7)
            assert_near(single[name].double(), value, 1e-3)


def test_some_trajectories_of_the_comparison_complete_and_some_do_not() -> None:
    done = [bool(tell(trajectory(seed, 10, 2, 40))[0]['completed']) for seed in range(4)]
    assert any(done)
    assert not all(done)


def test_metrics_at_any_step_are_those_of_the_trajectory_up_to_it() -> None:
    states = trajectory(1, 5, 2, 12)
    for end in range(1, 13):
        expected = trajectory_metrics([World.of(s) for s in states[:end]], 500)
        result, _ = tell(states[:end], 500)
        for name, value in expected.items():
            assert_near(result[name].double(), value, 1e-7)


def test_metrics_of_mixed_worlds_in_one_batch_are_those_of_each_alone() -> None:
    runs = [trajectory(seed, n, m, 10) for seed, n, m in [(0, 1, 1), (1, 20, 3), (2, 7, 6)]]
    together, tally = tell([batch(list(states)) for states in zip(*runs, strict=True)])
    for index, states in enumerate(runs):
        alone, _ = tell(states)
        for name in METRICS:
            assert_near(together[name][index].double(), alone[name].double(), 1e-9)
    one = tally.world(1)
    assert_near(one.flock_path, tally.flock_path[1], 0.0)
    assert one.reached.shape == (20,)
