"""A rollout is the laws one after the other, and computes what is read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
from reference import assert_same_world
from shepherd_ros.sim import rollout
from shepherd_ros.sim.lidar import LidarConfig, scan
from shepherd_ros.sim.metrics import count_step, metrics, start_tally
from shepherd_ros.sim.perception import perceive
from shepherd_ros.sim.reward import reward_terms
from shepherd_ros.sim.rollout import advance, advance_to, EnvConfig, Moment, restart, start
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.transition import step
from shepherd_ros.sim.world import WorldConfig
import torch

CONFIG = EnvConfig(
    noise_std=0.3,
    world=WorldConfig(n_sheep=6, n_shepherds=2, episode_steps=4),
    lidar=LidarConfig(n_rays=16),
)
COMMAND = torch.tensor([[0.5, 0.2], [-0.3, 0.9]]).expand(3, 2, 2)


def first(count: bool = True, seed: int = 5) -> Moment:
    """Return the start of three worlds."""
    return start(spawn(CONFIG.world, torch.arange(seed, seed + 3)), CONFIG, count)


def same_numbers(result: dict[str, torch.Tensor], expected: dict[str, torch.Tensor]) -> None:
    assert set(result) == set(expected)
    for name, value in expected.items():
        assert torch.equal(result[name], value), name


def test_a_moment_is_the_laws_one_after_the_other() -> None:
    moment = first()
    state, tally = moment.state, start_tally(moment.state)
    for _ in range(4):
        assert not moment.truncated.any()
        after = step(state, COMMAND, CONFIG.world)
        moment, tally = advance(moment, COMMAND), count_step(tally, state, after)
        assert_same_world(moment.before, state)
        assert_same_world(moment.state, after)
        seen = perceive(after, 0.3)
        assert_same_world(moment.perceived, seen)
        assert torch.equal(moment.ranges, scan(seen, CONFIG.lidar))
        terms = reward_terms(after, CONFIG.reward, 4, state)
        same_numbers(moment.reward_terms, terms)
        torch.testing.assert_close(moment.reward, torch.stack(list(terms.values())).sum(dim=0))
        same_numbers(moment.metrics(), metrics(tally, after, 4))
        same_numbers(moment.metrics(9), metrics(tally, after, 9))
        state = after
    assert moment.truncated.all()
    assert not moment.terminated.any()


def test_what_is_not_read_is_not_computed_and_nothing_is_computed_twice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[str] = []

    def called(law: Callable[..., Any], name: str, *given: Any) -> Any:
        calls.append(name)
        return law(*given)

    for name in ('perceive', 'scan', 'reward_terms', 'start_tally', 'count_step'):
        law = getattr(rollout, name)
        monkeypatch.setattr(rollout, name, partial(called, law, name))
    moment = advance(advance(first(count=False), COMMAND), COMMAND)
    assert calls == []
    for _ in range(2):
        assert moment.ranges is moment.ranges
        assert moment.reward_terms is moment.reward_terms
    assert calls == ['perceive', 'scan', 'reward_terms']
    calls.clear()
    advance(first(), COMMAND)
    assert calls == ['start_tally', 'count_step']


def test_a_goal_is_moved_before_the_moment_is_counted() -> None:
    moment, goal = first(), torch.tensor([7.0, -2.0])
    after = step(moment.state, COMMAND, CONFIG.world)
    after = replace(after, goal=goal.expand(3, 2))
    moved = advance(moment, COMMAND, goal)
    assert_same_world(moved.state, after)
    same_numbers(moved.metrics(), advance_to(moment, after).metrics())


def test_a_restarted_world_begins_and_the_others_go_on() -> None:
    moment = advance(advance(first(), COMMAND), COMMAND)
    fresh = first(seed=50)
    result = restart(moment, torch.tensor([False, True, False]), fresh.state)
    for b, expected in enumerate((moment, fresh, moment)):
        assert_same_world(result.state.world(b), expected.state.world(b))
        assert_same_world(result.before.world(b), expected.before.world(b))
        for name, value in expected.metrics().items():
            assert torch.equal(result.metrics()[name][b], value[b]), name
    assert restart(first(count=False), torch.tensor([True] * 3), fresh.state).tally is None


def test_what_follows_from_a_state_is_computed_once() -> None:
    """The count of a step takes the center before it from the count of the step that led there."""
    state = advance(first(), COMMAND).state
    for name in ('center', 'flock_size', 'team_size', 'gap', 'inside'):
        assert getattr(state, name) is getattr(state, name), name
