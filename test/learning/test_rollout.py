"""A rollout gives the learner what happened in the environment."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import product

import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.learning.group import team_reward, WorldGroup
from shepherd_ros.learning.ppo import PPOConfig, PPOLearner
from shepherd_ros.learning.ppo_rollout import Rollout
from shepherd_ros.learning.task import base_world, draw_environment, start_of, TaskConfig
from shepherd_ros.learning.validation import VALIDATION_SEED
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.flocking.reynolds_flock import ReynoldsFlock
from shepherd_ros.sim.flocking.strombom_flock import StrombomFlock
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import ObservationConfig, rotate_by_ray
from shepherd_ros.sim.presets import home_world
from shepherd_ros.sim.rng import FIRST_MIXED
import torch
from torch import Tensor

WORLDS, DECISIONS, STEPS = 3, 5, 12
TASK = TaskConfig(sheep_min=5, sheep_max=9, shepherds_max=3, episode_steps=STEPS, noise_max=0.5)


def policy_of(repeat: int = 2, spacing: int = 4, **observation: object) -> Policy:
    torch.manual_seed(7)
    return Policy(
        PolicyConfig(
            decision_interval=0.5 * repeat,
            lidar=LidarConfig(n_rays=64),
            observation=ObservationConfig(frame_interval=0.5 * spacing, unit=10.0, **observation),  # type: ignore[arg-type]
            network=NetworkConfig(filters_1=2, filters_2=2, hidden=8),
        )
    )


def rollout_of(policy: Policy, groups: int = 2) -> Rollout:
    return Rollout(TASK, policy, groups, WORLDS, DECISIONS, 3, torch.float32)


@pytest.mark.parametrize(('repeat', 'spacing'), [(1, 1), (2, 4), (3, 3)])
@pytest.mark.parametrize('align', ['world', 'goal'])
def test_inputs_rewards_and_values_are_those_of_the_environment(
    repeat: int, spacing: int, align: str
) -> None:
    policy = policy_of(repeat, spacing, align=align)
    rollout = rollout_of(policy, groups=1)
    group = rollout.groups[0]
    config = group.moment.config
    env_config = replace(
        config,
        world=replace(config.world, episode_steps=STEPS),
        lidar=policy.config.lidar,
        observation=policy.config.observation,
    )
    env = ShepherdEnv(env_config, WORLDS)
    stack, _ = env.reset(group.moment.state.seed.tolist())
    scale = 7.0
    batch, _ = rollout.collect(0.5, 0.0, scale)
    masks = rollout.store.mask[0, rollout.store.before :][:DECISIONS]
    place = 0
    for t in range(min(DECISIONS, STEPS // repeat)):
        mask = masks[t]
        count = int(mask.sum())
        chosen = slice(place, place + count)
        place += count
        assert stack is not None
        frames = stack[mask]
        first = policy.first_ray(frames[:, -1])
        x = policy.arrange(policy.scale(frames), first)
        torch.testing.assert_close(
            rollout.store.inputs(batch.rows[chosen], batch.first[chosen]), x
        )
        value = policy.critic(x)
        torch.testing.assert_close(batch.value[chosen], value, atol=1e-5, rtol=1e-5)
        command = torch.zeros(WORLDS, TASK.shepherds_max, 2)
        command[mask] = rotate_by_ray(batch.action[chosen], first, 64)
        total = torch.zeros(WORLDS)
        for _ in range(repeat):
            stack, reward, _, _, info = env.step(command)
            total += reward
        if 'final_observation' in info:
            stack = info['final_observation']
        assert stack is not None
        # with lambda 0 the advantage is the error of one decision; the end is bootstrapped
        later = stack[mask]
        after = policy.critic(policy.arrange(policy.scale(later), policy.first_ray(later[:, -1])))
        # the environment's rewards are per episode step, and this one has fewer steps
        gained = (total * STEPS / config.world.episode_steps * scale)[:, None].expand(mask.shape)
        error = gained[mask] + 0.5 * after - value
        torch.testing.assert_close(batch.advantage[chosen], error, atol=1e-4, rtol=1e-4)


def test_effort_costs_each_shepherd_its_own_way() -> None:
    policy = policy_of()
    plain = rollout_of(policy, groups=1).groups[0]
    paying = WorldGroup(replace(TASK, effort=0.01), 0, WORLDS, 3, policy.config.lidar)
    paying.begin(plain.left)
    command = torch.zeros(WORLDS, TASK.shepherds_max, 2)
    command[:, 0] = torch.tensor([0.3, 0.4])  # 0.5 m/s: below the top speed
    command[:, 1] = torch.tensor([0.0, 400.0])  # cut to the top speed
    world = plain.moment.config.world
    top, dt = world.shepherd_speed, world.dt
    lost = plain.hold(command, 3, team_reward) - paying.hold(command, 3, team_reward)
    expected = 3 * dt * 0.01 * torch.tensor([0.5, top, 0.0]) * plain.moment.state.shepherd_mask
    torch.testing.assert_close(lost, expected, atol=1e-6, rtol=1e-4)
    assert lost.max() > 0


def test_frames_do_not_reach_over_the_start_of_an_episode() -> None:
    policy = policy_of(repeat=2, spacing=4)
    rollout = rollout_of(policy)
    for _ in range(4):
        batch, _ = rollout.collect(0.9, 0.9, 1.0)
        rows = rollout.store.mask.shape[1]
        per_row = WORLDS * TASK.shepherds_max
        group, row = batch.rows // (rows * per_row), batch.rows // per_row % rows
        newest = row[:, -1]
        world = batch.rows[:, -1] // TASK.shepherds_max % WORLDS
        begun = rollout.store.begun[group[:, -1], newest, world]
        assert (row >= begun[:, None]).all()
        back = torch.tensor([4, 2, 0])
        assert torch.equal(row, torch.maximum(newest[:, None] - back, begun[:, None]))
        rollout.roll()


def numbers(policy: Policy, rollout: Rollout, updates: int) -> list[Tensor]:
    """Train on; return what came of it."""
    learner, generator = (
        PPOLearner(policy, PPOConfig(minibatch_size=64)),
        torch.Generator().manual_seed(1),
    )
    for _ in range(updates):
        batch, _ = rollout.collect(0.9, 0.9, 1.0)
        learner.update(rollout.store, batch, generator)
        rollout.roll()
    weights = [p.detach().clone() for p in policy.parameters()]
    return [*weights, rollout.groups[0].moment.state.sheep]


def test_the_same_seed_gives_the_same_training() -> None:
    one, two = policy_of(), policy_of()
    for a, b in zip(
        numbers(one, rollout_of(one), 4), numbers(two, rollout_of(two), 4), strict=True
    ):
        assert torch.equal(a, b)


def test_runs_groups_and_episodes_start_apart_and_from_what_is_held_out() -> None:
    task, seen = replace(TASK, sheep_max=5), set[bytes]()
    for seed, index, episode in product((0, 1), (0, 1), range(3)):
        group = WorldGroup(task, index, 1500, seed, LidarConfig(n_rays=64))
        group.episode = episode
        group.begin(1)
        assert group.moment.state.seed.min() >= FIRST_MIXED > VALIDATION_SEED
        seen |= {sheep.numpy().tobytes() for sheep in group.moment.state.sheep}
    assert len(seen) == 12 * 1500


def test_worlds_are_drawn_from_the_task() -> None:
    task = TaskConfig(
        flock='both', sheep_min=10, sheep_max=200, repulsion_min=0.5, repulsion_max=4.0,
        noise_max=2.0, goal_radius_min=3.0, goal_radius_max=9.0, shepherds_min=2, shepherds_max=5,
    )  # fmt: skip
    drawn = [draw_environment(task, seed) for seed in range(400)]
    assert draw_environment(task, 17) == drawn[17]
    kinds = {type(env.world.flock) for env in drawn}
    assert kinds == {StrombomFlock, ReynoldsFlock}
    sheep = [env.world.n_sheep for env in drawn]
    assert (min(sheep), max(sheep)) >= (10, 180)
    assert max(sheep) <= 200
    repulsion = [
        env.world.flock.sheep_repulsion
        for env in drawn
        if isinstance(env.world.flock, StrombomFlock)
    ]
    assert min(repulsion) < 1 < 3.5 < max(repulsion)
    assert all(0 <= env.noise_std <= 2 for env in drawn)
    spawn = drawn[0].world.spawn
    assert (drawn[0].world.n_shepherds, spawn.fewest_shepherds) == (5, 2)
    assert (drawn[0].world.goal_radius, spawn.goal_radius_extra) == (3.0, 6.0)


def test_a_share_of_the_episodes_starts_at_home_and_nothing_else_changes() -> None:
    usual = TaskConfig(sheep_min=10, noise_max=1.0)
    drawn = [draw_environment(replace(usual, home_share=0.3), seed) for seed in range(1000)]
    home = [env.world.spawn.shepherds_around for env in drawn]
    assert sum(home) / 1000 == pytest.approx(0.3, abs=0.04)
    for seed, env in enumerate(drawn):
        plain = draw_environment(usual, seed)
        world = home_world(plain.world) if home[seed] else plain.world
        assert env == replace(plain, world=world)


def test_a_share_of_the_episodes_is_without_noise_and_nothing_else_changes() -> None:
    usual = TaskConfig(sheep_min=10, noise_max=1.0, home_share=0.2)
    drawn = [draw_environment(replace(usual, noise_free_share=0.3), seed) for seed in range(1000)]
    quiet = [env.noise_std == 0 for env in drawn]
    assert sum(quiet) / 1000 == pytest.approx(0.3, abs=0.04)
    for seed, env in enumerate(drawn):
        plain = draw_environment(usual, seed)
        assert env == (replace(plain, noise_std=0.0) if quiet[seed] else plain)


def test_starts_at_home_are_as_far_from_the_goal_as_the_task_says() -> None:
    task = TaskConfig(home_share=1.0, home_distance_min=3.0, home_distance_max=9.0)
    world = draw_environment(task, 0).world
    state = start_of(task, world, torch.arange(400))
    away = torch.linalg.vector_norm(state.center - state.goal, dim=-1)
    assert 2.5 < away.min() < 3.5
    assert 8.5 < away.max() < 9.5
    near = replace(task, home_distance_min=0.0, home_distance_max=2.0)
    assert draw_environment(near, 0).world == home_world(draw_environment(TaskConfig(), 0).world)


def test_small_teams_are_drawn_more_often_in_the_same_places() -> None:
    task = TaskConfig(shepherds_min=1, shepherds_max=4, team_exponent=1.0)
    world, seeds = base_world(task, 'strombom'), torch.arange(5000)
    state = start_of(task, world, seeds)
    share = torch.bincount(state.team_size, minlength=5)[1:] / 5000
    expected = torch.tensor([12.0, 6.0, 4.0, 3.0]) / 25  # in proportion to 1, 1/2, 1/3, 1/4
    torch.testing.assert_close(share, expected, atol=0.02, rtol=0)
    even = start_of(replace(task, team_exponent=0.0), world, seeds)
    assert torch.equal(even.sheep, state.sheep)
    both = state.shepherd_mask & even.shepherd_mask
    assert torch.equal(even.shepherds[both], state.shepherds[both])
    assert (state.shepherds[~state.shepherd_mask] == 0).all()
    assert set(start_of(replace(task, shepherds_min=3), world, seeds).team_size.tolist()) == {3, 4}


def test_on_a_logarithmic_scale_each_doubling_of_a_flock_is_as_frequent() -> None:
    even = TaskConfig(sheep_min=10, sheep_max=319, noise_max=1.0)
    task, count = replace(even, sheep_scale='log'), Counter[int]()
    for seed in range(2000):
        env, plain = draw_environment(task, seed), draw_environment(even, seed)
        sheep = env.world.n_sheep
        count[next(k for k in range(5) if sheep < 20 << k)] += 1
        assert env == replace(plain, world=replace(plain.world, n_sheep=sheep))
    assert sorted(count) == [0, 1, 2, 3, 4]  # 10 to 19, 20 to 39, ... 160 to 319
    assert all(abs(n - 400) < 4 * 18 for n in count.values())  # of a standard deviation of 18
    alone = TaskConfig(sheep_scale='log', sheep_min=7, sheep_max=7)
    assert {draw_environment(alone, seed).world.n_sheep for seed in range(50)} == {7}


def test_a_task_whose_limits_are_the_wrong_way_round_is_refused() -> None:
    with pytest.raises(ConfigError, match='sheep_min is 300: expected at most sheep_max, 100'):
        TaskConfig(sheep_min=300)
