"""The environment for Gymnasium and PettingZoo: their checkers, and the same worlds."""

from __future__ import annotations

from dataclasses import replace

import gymnasium
import gymnasium.utils.env_checker
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics
import numpy as np
from pettingzoo.test import parallel_api_test, parallel_seed_test
import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.integrations.environments import HerdingEnv, HerdingParallelEnv, HerdingVectorEnv
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import first_ray, network_input, ObservationConfig, rotate_by_ray
from shepherd_ros.sim.presets import training_world, world_preset
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import WorldConfig
import stable_baselines3.common.env_checker
import torch

WORLD = WorldConfig(n_sheep=8, n_shepherds=2, episode_steps=7, shepherd_speed=0.8)
CONFIG = EnvConfig(world=WORLD, observation=ObservationConfig(align='goal', unit=10.0))


def test_pettingzoo_is_content() -> None:
    parallel_api_test(HerdingParallelEnv(CONFIG), num_cycles=30)
    parallel_seed_test(lambda: HerdingParallelEnv(CONFIG), num_cycles=10)


@pytest.mark.parametrize(
    'observation',
    [ObservationConfig(), CONFIG.observation, ObservationConfig(range_min=1.5, none_value=-1.0)],
)
def test_vector_environments_are_those_of_the_core(observation: ObservationConfig) -> None:
    config = replace(CONFIG, observation=observation)
    env, core = HerdingVectorEnv(config, 3), ShepherdEnv(config, 3)
    seen, _ = env.reset(seed=4)
    stack, _ = core.reset(4)
    draw = np.random.default_rng(0)
    for step in range(1, 17):
        assert stack is not None
        expected = network_input(stack, observation, 75.0).flatten(0, 1)
        assert np.array_equal(seen, expected)
        assert env.observation_space.contains(seen)
        action = draw.uniform(-1, 1, (6, 2)).astype(np.float32)
        direction = torch.from_numpy(action).unflatten(0, (3, 2)) * 0.8
        command = rotate_by_ray(direction, first_ray(stack[..., -1, :, :], observation), 512)
        seen, reward, terminated, truncated, info = env.step(action)
        stack, gained, _, _, output = core.step(command)
        assert np.array_equal(reward, gained.repeat_interleave(2))
        assert not terminated.any()
        assert truncated.all() == truncated.any() == (step % 7 == 0)
        if truncated.any():
            final = network_input(output['final_observation'], observation, 75.0).flatten(0, 1)
            assert np.array_equal(info['final_obs'], final)
            assert info['_final_obs'].all()
            reached = output['final_metrics']['fraction_reached'].repeat_interleave(2)
            assert np.array_equal(info['final_info']['fraction_reached'], reached)


def test_copies_and_later_episodes_have_starts_of_their_own() -> None:
    config = replace(CONFIG, world=replace(WORLD, n_shepherds=1, episode_steps=2))
    one, starts = HerdingParallelEnv(config), set[bytes]()
    for seed in (*range(8), None):
        for episode in range(20):
            seen, _ = one.reset(seed if episode == 0 else None)
            starts.add(seen['shepherd_0'].tobytes())
    assert len(starts) == 9 * 20
    unseeded = [HerdingEnv(config).reset()[0] for _ in range(2)]
    assert not np.array_equal(*unseeded), 'the first episode without a seed is any'
    for env in (HerdingVectorEnv(config, 2), HerdingEnv(config)):
        env.reset(seed=5)
        first, second = (env.reset()[0] for _ in range(2))
        assert not np.array_equal(first, second)
        zero, _ = env.reset(seed=0)
        assert not np.array_equal(second, zero)


def test_one_shepherd_has_an_id_that_both_checkers_accept() -> None:
    env = gymnasium.make('shepherd_ros.integrations.environments:shepherd_ros/Herding-v0')
    gymnasium.utils.env_checker.check_env(env.unwrapped)
    stable_baselines3.common.env_checker.check_env(env.unwrapped)
    config = replace(CONFIG, world=replace(WORLD, n_shepherds=1))
    single = gymnasium.make('shepherd_ros/Herding-v0', config=config)
    many = gymnasium.make_vec('shepherd_ros/Herding-v0', 3, config=config)
    seen, _ = single.reset(seed=1)
    expected, _ = many.reset(seed=1)
    assert (many.num_envs, len(expected)) == (3, 3)
    for _ in range(7):
        assert np.array_equal(seen, expected[0])
        actions = many.action_space.sample()
        seen, reward, _, ended, info = single.step(actions[0])
        expected, gained, _, _, output = many.step(actions)
        assert reward == gained[0]
    assert ended
    assert np.array_equal(seen, output['final_obs'][0])
    assert info['fraction_reached'] == output['final_info']['fraction_reached'][0]
    with pytest.raises(ConfigError, match='n_shepherds is 2: expected 1; take HerdingVectorEnv'):
        gymnasium.make('shepherd_ros/Herding-v0', config=CONFIG)


def test_the_end_is_told_as_gymnasium_tells_it_in_the_same_step() -> None:
    env = HerdingVectorEnv(CONFIG, 2)
    with pytest.raises(ConfigError, match=r'expected reset\(\) before step'):
        env.step(env.action_space.sample())
    assert env.autoreset_mode == AutoresetMode.SAME_STEP  # TorchRL's GymWrapper asks for it
    env.reset(seed=0)
    for _ in range(7):
        *_, info = env.step(env.action_space.sample())
    assert info['_final_obs'].all()
    assert info['_final_info'].all()
    names = [name for name in info['final_info'] if name[0] != '_']
    assert names
    assert all(info['final_info'][f'_{name}'].all() for name in names)


def test_a_step_after_the_end_is_empty_and_one_before_the_start_an_error() -> None:
    env = HerdingParallelEnv(CONFIG)
    with pytest.raises(ConfigError, match=r'expected reset\(\) before step'):
        env.step({})
    env.reset(seed=0)
    while env.agents:
        env.step({name: env.action_space(name).sample() for name in env.agents})
    assert env.step({}) == ({}, {}, {}, {}, {})


def test_wrappers_of_gymnasium_work() -> None:
    env = RecordEpisodeStatistics(HerdingVectorEnv(CONFIG, 2))
    assert env.metadata['autoreset_mode'] == AutoresetMode.SAME_STEP
    env.reset(seed=0)
    total = np.zeros(4)
    for _ in range(7):
        _, reward, _, _, info = env.step(env.action_space.sample())
        total += reward
    assert info['episode']['l'].tolist() == [7] * 4
    np.testing.assert_allclose(info['episode']['r'], total, rtol=1e-5)


def test_a_parallel_environment_is_one_world_of_the_vector_environment() -> None:
    one, many = HerdingParallelEnv(CONFIG), HerdingVectorEnv(CONFIG, 1)
    seen, _ = one.reset(seed=9)
    expected, _ = many.reset(seed=9)
    for _ in range(7):
        assert np.array_equal(np.stack(list(seen.values())), expected)
        action = many.action_space.sample()
        seen, reward, _, truncated, info = one.step(dict(zip(one.agents, action, strict=True)))
        expected, gained, _, _, output = many.step(action)
        assert list(reward.values()) == gained.tolist()
    assert all(truncated.values())
    assert one.agents == []
    assert np.array_equal(np.stack(list(seen.values())), output['final_obs'])
    assert info['shepherd_0']['fraction_reached'] == output['final_info']['fraction_reached'][0]


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ConfigError, match='fewest_shepherds is 1: expected 0'):
        HerdingVectorEnv(EnvConfig(world=training_world(WORLD)))
    with pytest.raises(ConfigError, match='expected one number'):
        HerdingVectorEnv(CONFIG, 1).reset(seed=[1])
    env = HerdingParallelEnv(CONFIG)
    env.reset(seed=0)
    with pytest.raises(ConfigError, match=r"actions lack \['shepherd_1'\]"):
        env.step({'shepherd_0': np.zeros(2, np.float32)})


@pytest.mark.parametrize('kind', [HerdingEnv, HerdingParallelEnv, HerdingVectorEnv])
def test_terminal_states_are_terminations_and_time_limits_truncations(kind: type) -> None:
    team = 1 if kind is HerdingEnv else 2
    world = replace(world_preset(task='protection'), n_sheep=150, n_shepherds=team)
    config = EnvConfig(world=replace(world, episode_steps=45), lidar=LidarConfig(n_rays=32))
    # of the vector environment, worlds that have begun anew count as well
    many = kind is HerdingVectorEnv
    env = kind(config, 8) if many else kind(config)
    core = ShepherdEnv(config, 8 if many else 1)
    ends, seed = np.zeros(2, int), 0
    while min(ends) < 2:
        env.reset(seed=seed)
        core.reset(seed)
        seed += 1
        for _ in range(45):
            if kind is HerdingParallelEnv:
                still = {name: np.zeros(2, np.float32) for name in env.agents}
                _, *parts, infos = env.step(still)
                reward, *over = (list(part.values()) for part in parts)
                info = infos['shepherd_1']
            else:
                _, reward, *over, info = env.step(np.zeros((16, 2) if many else 2, np.float32))
            _, gained, *expected, _ = core.step(torch.zeros_like(core.state.shepherds))
            each = gained.repeat_interleave(team).numpy()
            assert np.array_equal(np.ravel(np.float32(reward)), each)
            for value, core_value in zip(over, expected, strict=True):
                assert np.array_equal(np.ravel(value), core_value.repeat_interleave(team).numpy())
            ends += [int(end.sum()) for end in expected]
            if np.any(over):
                assert 'clean_success' in (info.get('final_info') or info)
                if not many:
                    break
