"""A goal that moves: along a line to its destination, or in a circle around it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest
from shepherd_ros.sim.lidar import LidarConfig, scan
from shepherd_ros.sim.lidar_layout import GOAL_CHANNEL
from shepherd_ros.sim.rollout import advance, EnvConfig, start
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.transition import step
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor

SEEDS = torch.arange(5)
STRAIGHT = WorldConfig(n_sheep=7, goal_speed=0.2, goal_distance=1.05, episode_steps=12)
CIRCLE = replace(STRAIGHT, goal_path='circle', goal_distance=3.0)


def path(world: WorldConfig, seed: Tensor) -> list[WorldState]:
    """Return the states of an episode in which no shepherd moves."""
    states = [spawn(world, seed)]
    for _ in range(world.episode_steps):
        states.append(step(states[-1], torch.zeros_like(states[-1].shepherds), world))
    return states


def test_a_goal_that_stands_is_where_it_was_and_its_own_destination() -> None:
    states = path(replace(STRAIGHT, goal_speed=0.0), SEEDS)
    for state in states:
        assert torch.equal(state.goal, torch.zeros(5, 2))
        assert torch.equal(state.destination, state.goal)


def test_a_straight_path_has_equal_strides_and_ends_at_the_destination_exactly() -> None:
    states = path(STRAIGHT, SEEDS)
    first = states[0]
    course = first.destination / 1.05
    assert torch.allclose(torch.linalg.vector_norm(course, dim=-1), torch.ones(5))
    assert len(course.unique(dim=0)) == 5  # each episode has a direction of its own
    for k, state in enumerate(states):
        assert torch.allclose(state.goal, course * min(0.2 * 0.5 * k, 1.05), atol=1e-6)
        assert torch.equal(state.destination, first.destination)
    assert torch.equal(states[-1].goal, first.destination)


def test_a_circle_keeps_its_distance_and_turns_by_speed_over_radius() -> None:
    states = path(CIRCLE, SEEDS)
    for before, after in pairwise(states):
        a, b = before.goal - before.destination, after.goal - after.destination
        assert torch.allclose(torch.linalg.vector_norm(b, dim=-1), torch.full((5,), 3.0))
        turn = torch.atan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(dim=-1))
        assert torch.allclose(turn, torch.full((5,), 0.2 * 0.5 / 3.0), atol=1e-5)


@pytest.mark.parametrize('world', [STRAIGHT, CIRCLE], ids=['straight', 'circle'])
def test_worlds_in_a_batch_move_their_goals_as_each_alone_does(world: WorldConfig) -> None:
    together = path(world, SEEDS)
    for b, seed in enumerate(SEEDS):
        for whole, alone in zip(together, path(world, seed), strict=True):
            assert torch.equal(whole.goal[b], alone.goal)
            assert torch.equal(whole.destination[b], alone.destination)


def test_absent_shepherds_stay_where_the_goal_started() -> None:
    world = replace(STRAIGHT, n_shepherds=4, spawn=replace(STRAIGHT.spawn, fewest_shepherds=1))
    states = path(world, torch.arange(20))
    absent = ~states[0].shepherd_mask
    assert absent.any()
    for state in (states[0], states[-1]):
        assert torch.equal(state.shepherds[absent], torch.zeros(int(absent.sum()), 2))


def test_metrics_reward_and_lidar_take_the_goal_of_the_step() -> None:
    """A goal that moves onto a sheep that stands has it inside, and is seen from where it is."""
    world = WorldConfig(
        n_sheep=1, n_shepherds=1, goal_radius=1.0, goal_speed=1.0, goal_distance=8.0, dt=1.0
    )
    world = world.with_values({'flock.graze_probability': 0.0})
    state = spawn(world, torch.tensor(3))
    far = state.destination + torch.tensor([40.0, 0.0])
    state = replace(state, sheep=state.destination[None], shepherds=far[None])
    moment = start(state, EnvConfig(world=world))
    inside, seen = [], []
    for _ in range(8):
        moment = advance(moment, torch.zeros(1, 2))
        inside.append(float(moment.metrics()['fraction_in_goal']))
        ranges = scan(moment.state, LidarConfig())[0, GOAL_CHANNEL]
        distance = float(torch.linalg.vector_norm(moment.state.goal - far))
        seen.append(abs(float(ranges.min()) - (distance - 1.0)))
    assert inside == [0.0] * 6 + [1.0] * 2
    assert float(moment.reward_terms['occupancy']) == pytest.approx(10 / 1000)
    assert float(moment.metrics()['completion_time']) == 7
    assert max(seen) < 0.1  # a ray of 512 misses the middle by up to 0.25 m at 40 m


def test_a_circle_of_no_radius_stands() -> None:
    world = replace(CIRCLE, goal_distance=0.0)
    assert torch.equal(path(world, SEEDS)[-1].goal, torch.zeros(5, 2))
