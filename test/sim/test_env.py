"""The environment: time limits, restarts, seeds, and many worlds at once."""

from __future__ import annotations

from dataclasses import replace
import math
from typing import Any

import pytest
from reference import assert_near, assert_same_world, trajectory_metrics, World
from shepherd_ros.config import ConfigError
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.flocking.reynolds_flock import ReynoldsFlock
from shepherd_ros.sim.flocking.strombom_flock import StrombomFlock
from shepherd_ros.sim.lidar import LidarConfig, scan
from shepherd_ros.sim.metrics import METRICS
from shepherd_ros.sim.observation import ObservationConfig
from shepherd_ros.sim.perception import perceive
from shepherd_ros.sim.reward import reward_terms, RewardConfig
from shepherd_ros.sim.rng import mixed_seeds
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.transition import step
from shepherd_ros.sim.world import SpawnConfig, WorldConfig
import torch
from torch import Tensor

FLOCKS = {'strombom': StrombomFlock(graze_probability=0.5), 'reynolds': ReynoldsFlock()}


def config(episode_steps: int = 1000, flock: str = 'strombom', **options: Any) -> EnvConfig:
    """Return a small environment with every source of noise in it, and teams of 1 to 3."""
    world = WorldConfig(
        n_sheep=12,
        n_shepherds=3,
        episode_steps=episode_steps,
        spawn=SpawnConfig(goal_radius_extra=4.0, fewest_shepherds=1),
        flock=FLOCKS[flock],
    )
    lidar = LidarConfig(n_rays=32, range_noise=0.1, dropout=0.05)
    return EnvConfig(**{'noise_std': 0.2, 'world': world, 'lidar': lidar, **options})


def action(env: ShepherdEnv) -> Tensor:
    """Return commands that follow from seed and step, some of them faster than allowed."""
    phase = (env.state.seed % 97)[:, None] + 0.3 * env.state.step[:, None] + torch.arange(3)
    return 1.3 * torch.stack([torch.cos(phase), torch.sin(phase)], dim=-1)


def advance(env: ShepherdEnv, steps: int) -> list[tuple[Any, ...]]:
    return [env.step(action(env)) for _ in range(steps)]


def same(a: Tensor, b: Tensor) -> bool:
    return torch.equal(a, b)


# --- one step -----------------------------------------------------------------------------------


def test_a_step_is_the_laws_one_after_the_other() -> None:
    env = ShepherdEnv(config(), 4)
    first, info = env.reset(seed=11)
    assert info['seed'].tolist() == [11, 12, 13, 14]
    state = spawn(env.config.world, torch.arange(11, 15))
    assert_same_world(env.state, state)
    ranges = scan(perceive(state, 0.2), env.config.lidar)
    assert same(first, env.frames.begin(ranges))
    command = action(env)
    observation, reward, terminated, truncated, info = env.step(command)
    after = step(state, command, env.config.world)
    assert_same_world(env.state, after)
    assert_same_world(env.perceived, perceive(after, 0.2))
    newest = scan(perceive(after, 0.2), env.config.lidar)
    assert same(observation, torch.stack([ranges, ranges, newest], dim=2))
    assert same(observation, env.stack)
    terms = reward_terms(after, env.config.reward, 1000)
    assert set(info) == {'reward_terms'}
    for name, value in terms.items():
        assert same(info['reward_terms'][name], value)
    assert_near(reward, terms['occupancy'] + terms['shaping'], 1e-9)
    assert terminated.dtype == truncated.dtype == torch.bool
    assert not terminated.any()
    assert not truncated.any()


def test_shapes_are_those_announced() -> None:
    env = ShepherdEnv(config(observation=ObservationConfig(n_frames=5)), 2)
    observation, _ = env.reset()
    assert observation.shape == (2, 3, 5, 3, 32)
    observation, reward, terminated, truncated, _ = env.step(action(env))
    assert observation.shape == (2, 3, 5, 3, 32)
    assert reward.shape == terminated.shape == truncated.shape == (2,)


def test_the_reward_uses_its_weights() -> None:
    env = ShepherdEnv(config(reward=RewardConfig(occupancy=0.0, shaping=0.0)), 2)
    env.reset()
    assert_near(env.step(action(env))[1], [0.0, 0.0], 0.0)


def test_a_command_that_is_not_finite_leaves_every_number_finite() -> None:
    env = ShepherdEnv(config(), 2)
    env.reset(seed=1)
    bad, zeroed = action(env), action(env)
    bad[0, 0, 0], bad[1, 0, 1] = math.nan, math.inf
    zeroed[0, 0], zeroed[1, 0] = 0.0, 0.0
    observation, reward, *_ = env.step(bad)
    other = ShepherdEnv(config(), 2)
    other.reset(seed=1)
    expected, expected_reward, *_ = other.step(zeroed)
    assert same(observation, expected)
    assert same(reward, expected_reward)
    assert not observation.isnan().any()


def test_without_lidar_there_is_no_observation_and_the_same_world() -> None:
    env, blind = ShepherdEnv(config(3), 2), ShepherdEnv(config(3), 2, lidar=False)
    env.reset(seed=5)
    assert blind.reset(seed=5)[0] is None
    for _ in range(7):
        observation, reward, _, truncated, info = blind.step(action(blind))
        assert observation is None
        assert same(reward, env.step(action(env))[1])
        assert_same_world(blind.state, env.state)
        assert_same_world(blind.perceived, env.perceived)
        assert not truncated.any() or info['final_observation'] is None


def test_metrics_are_those_of_the_trajectory_of_true_states() -> None:
    env = ShepherdEnv(config(), 3)
    env.reset(seed=2)
    states = [env.state]
    for _ in range(15):
        env.step(action(env))
        states.append(env.state)
    result = env.metrics()
    for b in range(3):
        expected = trajectory_metrics([World.of(s.world(b)) for s in states], 1000)
        for name in METRICS:
            assert_near(result[name][b].double(), expected[name], 1e-3)


# --- the end of an episode ----------------------------------------------------------------------


def test_every_episode_is_truncated_at_its_limit_and_never_terminated() -> None:
    env = ShepherdEnv(config(4), 3)
    env.reset()
    ends = []
    for _ in range(12):
        _, _, terminated, truncated, info = env.step(action(env))
        assert not terminated.any()
        assert truncated.all() or not truncated.any()
        assert ('final_state' in info) == bool(truncated.any())
        ends.append(bool(truncated.any()))
    assert ends == [False, False, False, True] * 3


def test_what_is_kept_of_an_ended_episode_is_what_a_longer_one_shows() -> None:
    short, long = ShepherdEnv(config(6), 3), ShepherdEnv(config(1000), 3)
    short.reset(seed=20)
    long.reset(seed=20)
    for _ in range(5):
        assert same(short.step(action(short))[0], long.step(action(long))[0])
    command = action(long)
    observation, reward, _, truncated, info = short.step(command)
    expected, *_ = long.step(command)
    assert truncated.all()
    assert same(info['final_observation'], expected)
    assert_same_world(info['final_state'], long.state)
    assert info['final_state'].step.tolist() == [6, 6, 6]
    longer = long.metrics()
    for name in METRICS:
        value = longer[name].clone()
        if name == 'completion_time':
            value[longer['completed'] == 0] = 6
        assert same(info['final_metrics'][name].double(), value.double()), name
    assert_near(
        reward, 1000 / 6 * sum(reward_terms(long.state, RewardConfig(), 1000).values()), 1e-6
    )
    assert not same(observation, expected)  # already that of the next episode


def test_what_was_kept_is_not_changed_by_later_steps() -> None:
    env = ShepherdEnv(config(2), 2)
    env.reset()
    info = advance(env, 2)[-1][4]
    stored = {name: info[name].clone() for name in ('final_observation',)}
    stored |= {name: value.clone() for name, value in info['final_metrics'].items()}
    sheep = info['final_state'].sheep.clone()
    advance(env, 3)
    assert same(info['final_observation'], stored['final_observation'])
    assert same(info['final_state'].sheep, sheep)
    for name, value in info['final_metrics'].items():
        assert same(value, stored[name])


def test_observations_handed_out_are_not_changed_by_later_steps() -> None:
    env = ShepherdEnv(config(3), 2)
    first, _ = env.reset()
    handed, copies = [first], [first.clone()]
    for observation, *_ in advance(env, 7):
        handed.append(observation)
        copies.append(observation.clone())
    assert all(same(a, b) for a, b in zip(handed, copies, strict=True))


def test_a_restarted_world_shows_its_first_reading_in_every_frame_and_counts_anew() -> None:
    env = ShepherdEnv(config(3), 2)
    env.reset(seed=4)
    observation, _, _, truncated, _ = advance(env, 3)[-1]
    assert truncated.all()
    fresh = ShepherdEnv(config(3), 2)
    expected, _ = fresh.reset(env.state.seed.tolist())
    assert same(observation, expected)
    assert same(observation, observation[:, :, :1].expand_as(observation))
    assert_same_world(env.state, fresh.state)
    for name, value in fresh.metrics().items():
        assert same(env.metrics()[name], value), name


def test_worlds_that_go_on_are_untouched_when_another_restarts() -> None:
    env, undisturbed = ShepherdEnv(config(9), 3), ShepherdEnv(config(1000), 3)
    offset = torch.tensor([0, 4, 6])  # the worlds end at steps 9, 5 and 3
    for e in (env, undisturbed):
        e.reset(seed=50)
        e.moment = replace(e.moment, state=replace(e.state, step=offset.clone()))
    remaining = [9, 5, 3]
    for t in range(1, 10):
        command = action(undisturbed)
        commands = torch.where((t <= torch.tensor(remaining))[:, None, None], command, action(env))
        observation, _, _, truncated, info = env.step(commands)
        expected, *_ = undisturbed.step(command)
        assert truncated.tolist() == [t % 9 == 0, t == 5, t == 3]
        tally, longer = env.metrics(), undisturbed.metrics()
        for b in range(3):
            if t < remaining[b]:
                assert same(observation[b], expected[b])
                assert_same_world(env.state.world(b), undisturbed.state.world(b))
                assert_same_world(env.perceived.world(b), undisturbed.perceived.world(b))
                for name in set(METRICS) - {'completion_time'}:
                    assert same(tally[name][b], longer[name][b]), name
            if t == remaining[b]:
                assert same(info['final_observation'][b], expected[b])
                assert_same_world(info['final_state'].world(b), undisturbed.state.world(b))
                assert int(env.state.step[b]) == 0
                assert int(env.state.seed[b]) == mixed_seeds(3, 50, 1)[b]
        if truncated.any():  # what is kept is that of all worlds, also of those that go on
            going = ~truncated
            assert same(info['final_observation'][going], observation[going])


# --- seeds --------------------------------------------------------------------------------------


def test_seeds_are_those_documented_over_three_episodes() -> None:
    env = ShepherdEnv(config(2), 3)
    env.reset(seed=100)
    seen = [env.state.seed.tolist()]
    for _ in range(2):
        advance(env, 2)
        seen.append(env.state.seed.tolist())
    env.reset()
    seen.append(env.state.seed.tolist())
    assert seen == [[100, 101, 102], *(mixed_seeds(3, 100, k).tolist() for k in (1, 2, 3))]


def test_what_cannot_be_is_told() -> None:
    one = ShepherdEnv(config(2), 2)
    with pytest.raises(ConfigError, match=r'expected reset\(\) before step\(\)'):
        one.step(torch.zeros(2, 2, 2))
    with pytest.raises(ConfigError, match=r'seed is \[1\]: expected one, or 2'):
        one.reset([1])


@pytest.mark.parametrize('flock', FLOCKS)
def test_worlds_together_equal_each_world_alone_bit_for_bit_over_twenty_steps(flock: str) -> None:
    together = ShepherdEnv(config(flock=flock), 4)
    alone = [ShepherdEnv(config(flock=flock), 1) for _ in range(4)]
    first, _ = together.reset(seed=30)
    for b, env in enumerate(alone):
        assert same(env.reset(seed=30 + b)[0][0], first[b])
    for _ in range(20):
        observation, reward, *_ = together.step(action(together))
        for b, env in enumerate(alone):
            one, its_reward, *_ = env.step(action(env))
            assert same(one[0], observation[b])
            assert same(its_reward[0], reward[b])
            assert_same_world(env.state.world(0), together.state.world(b))
    for b, env in enumerate(alone):
        for name, value in env.metrics().items():
            assert same(value[0], together.metrics()[name][b]), name


def test_an_episode_is_the_same_whatever_the_number_of_worlds() -> None:
    many, one = ShepherdEnv(config(5), 3), ShepherdEnv(config(5), 1)
    many.reset(seed=7)
    advance(many, 5)
    one.reset(seed=int(many.state.seed[1]))
    assert same(many.stack[1], one.stack[0])
    for _ in range(4):
        observation, reward, *_ = many.step(action(many))
        alone, its_reward, *_ = one.step(action(one))
        assert same(observation[1], alone[0])
        assert same(reward[1], its_reward[0])


@pytest.mark.parametrize('flock', FLOCKS)
def test_the_same_seed_gives_the_same_episode_and_another_seed_another(flock: str) -> None:
    def run(seed: int) -> tuple[Tensor, Tensor]:
        env = ShepherdEnv(config(8, flock), 2)
        env.reset(seed)
        steps = advance(env, 20)
        return torch.stack([s[0] for s in steps]), torch.stack([s[1] for s in steps])

    first, again, other = run(3), run(3), run(4)
    assert same(first[0], again[0])
    assert same(first[1], again[1])
    assert not same(first[1], other[1])


def test_a_reset_forgets_everything() -> None:
    used, fresh = ShepherdEnv(config(5), 2), ShepherdEnv(config(5), 2)
    used.reset(seed=1)
    advance(used, 7)
    assert same(used.reset(seed=2)[0], fresh.reset(seed=2)[0])
    for (a, b, *_), (c, d, *_) in zip(advance(used, 6), advance(fresh, 6), strict=True):
        assert same(a, c)
        assert same(b, d)
    for name, value in fresh.metrics().items():
        assert same(used.metrics()[name], value)


@pytest.mark.parametrize('seed', [-(2**63), -1, 2**63 - 3])
def test_seeds_may_be_any_signed_64_bit_number(seed: int) -> None:
    env = ShepherdEnv(config(2), 2)
    observation, info = env.reset(seed)
    assert info['seed'].tolist() == [seed, seed + 1]
    for observation, reward, *_ in advance(env, 4):
        assert not observation.isnan().any()
        assert reward.isfinite().all()
