"""The worlds for Stable-Baselines3: the same as for Gymnasium, and the script that trains."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import runpy
import sys

import numpy as np
import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.integrations.environments import HerdingVectorEnv
from shepherd_ros.integrations.sb3 import evaluate, HerdingVecEnv, LidarFeatures
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import ObservationConfig
from shepherd_ros.sim.presets import world_preset
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import WorldConfig
from stable_baselines3 import PPO

SCRIPT = Path(__file__).resolve().parents[2] / 'scripts' / 'train_sb3.py'
CONFIG = EnvConfig(
    world=WorldConfig(n_sheep=8, n_shepherds=2, episode_steps=6),
    lidar=LidarConfig(n_rays=64),
    observation=ObservationConfig(layout='ring', align='goal', unit=10.0),
)


@pytest.mark.parametrize('hold', [1, 3])
def test_worlds_are_those_of_gymnasium_with_actions_held(hold: int) -> None:
    env, core = HerdingVecEnv(CONFIG, 3, hold * 0.5), HerdingVectorEnv(CONFIG, 3)
    env.seed(4)
    assert np.array_equal(env.reset(), core.reset(seed=4)[0])
    assert env.num_envs == 6
    draw = np.random.default_rng(0)
    for step in range(1, 12 // hold + 1):
        action = draw.uniform(-1, 1, (6, 2)).astype(np.float32)
        seen, reward, done, infos = env.step(action)
        gains = []
        for _ in range(hold):
            expected, gain, _, ended, printed = core.step(action)
            gains.append(gain)
        assert np.array_equal(seen, expected)
        np.testing.assert_allclose(reward, sum(gains), rtol=1e-6)
        assert done.tolist() == ended.tolist() == [step * hold % 6 == 0] * 6
        for i, info in enumerate(infos):
            assert info['TimeLimit.truncated'] == done[i]  # so that PPO bootstraps the value
            assert ('terminal_observation' in info) == done[i]
            if done[i]:
                assert np.array_equal(info['terminal_observation'], printed['final_obs'][i])
                reached = printed['final_info']['fraction_reached'][i]
                assert info['metrics']['fraction_reached'] == reached


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(
        ConfigError,
        match=r'decision_interval is 2.0 s, 4 steps of 0.5 s: .* divisor of episode_steps, 6',
    ):
        HerdingVecEnv(CONFIG, 1, 2.0)
    env = HerdingVecEnv(CONFIG, 1)
    assert env.get_attr('team') == [2, 2]
    assert env.env_is_wrapped(object) == [False, False]  # type: ignore[arg-type]
    with pytest.raises(AttributeError, match='single shepherds'):
        env.set_attr('team', 3)
    with pytest.raises(AttributeError, match='single shepherds'):
        env.env_method('reset')


def test_an_evaluation_is_a_function_of_the_seed_and_of_the_model() -> None:
    kind = {'features_extractor_class': LidarFeatures}
    model = PPO(
        'MlpPolicy', HerdingVecEnv(CONFIG, 2, 1.0), policy_kwargs=kind, seed=0, device='cpu'
    )
    first = evaluate(model, CONFIG, 4, 1.0, seed=7)
    assert evaluate(model, CONFIG, 4, 1.0, seed=7) == first
    assert evaluate(model, CONFIG, 4, 1.0, seed=8) != first
    core, total = HerdingVectorEnv(CONFIG, 4), np.zeros(8)
    seen, _ = core.reset(seed=7)
    for step in range(6):
        if step % 2 == 0:
            action, _ = model.predict(seen, deterministic=True)
        seen, reward, _, _, info = core.step(action)
        total += reward
    assert first['return'] == pytest.approx(total.mean(), rel=1e-6)
    assert first['completion_time'] == pytest.approx(info['final_info']['completion_time'].mean())


def test_the_script_trains_and_saves_a_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'model.zip'
    options = {'out': out, 'samples': 400, 'shepherds': 2, 'steps': 40, 'worlds': 40, 'rays': 64}
    words = [f'--{name}={value}' for name, value in options.items()]
    monkeypatch.setattr(sys, 'argv', [str(SCRIPT), *words])
    runpy.run_path(str(SCRIPT), run_name='__main__')
    output = capsys.readouterr().out
    assert 'before: {' in output
    assert 'after:  {' in output
    model = PPO.load(out, device='cpu')
    assert model.num_timesteps == 400
    action, _ = model.predict(np.zeros((5, 9, 64), np.float32), deterministic=True)
    assert action.shape == (5, 2)


def test_the_script_says_how_to_install_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.split('.')[0] == 'stable_baselines3']:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, 'stable_baselines3', None)
    monkeypatch.setattr(sys, 'argv', [str(SCRIPT)])
    with pytest.raises(SystemExit, match=r"pip install -c constraints.txt '\.\[sb3\]'"):
        runpy.run_path(str(SCRIPT), run_name='__main__')


def test_a_terminal_state_is_no_time_limit_and_ends_the_reward_of_a_held_action() -> None:
    world = replace(world_preset(task='protection'), n_sheep=150, n_shepherds=1, episode_steps=48)
    env = HerdingVecEnv(EnvConfig(world=world, lidar=LidarConfig(n_rays=32)), 12, 2.0)
    env.seed(0)
    env.reset()
    limits = {True: 0, False: 0}
    for _ in range(24):
        _, reward, done, infos = env.step(np.zeros((12, 2), np.float32))
        for gain, ended, info in zip(reward, done, infos, strict=True):
            assert ended == ('metrics' in info)
            if ended:
                limits[info['TimeLimit.truncated']] += 1
                assert (gain < -1.9) != info['TimeLimit.truncated']
    assert min(limits.values()) > 0
