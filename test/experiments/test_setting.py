"""A setting is a base and what is changed of its environment by path."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import pytest
from shepherd_ros.cli import main
from shepherd_ros.config import ConfigError
from shepherd_ros.experiments.campaign import plan
from shepherd_ros.experiments.catalog import EXPERIMENTS
from shepherd_ros.experiments.methods import make_method
from shepherd_ros.experiments.results import read_results
from shepherd_ros.experiments.samples import samples_of
from shepherd_ros.experiments.setting import (
    canonical_setting,
    changes_of,
    describe_setting,
    env_config,
    Setting,
)
from shepherd_ros.recordings.episodes import iter_episodes
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.sim.flocking.reynolds_flock import ReynoldsFlock
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import SpawnConfig, WorldConfig


def test_short_names_have_the_defaults_of_the_options_that_they_stand_for() -> None:
    values = EnvConfig().values()
    for f in fields(Setting):
        if 'path' in f.metadata and f.name != 'repulsion':
            assert getattr(Setting(), f.name) == values[f.metadata['path']], f.name
            assert type(f.default) is type(values[f.metadata['path']]), f.name
    assert env_config(Setting()) == EnvConfig()
    assert changes_of(Setting()) == {}
    assert canonical_setting(Setting()).repulsion == WorldConfig().flock.sheep_repulsion


def test_every_option_can_be_set_by_its_path() -> None:
    for path, value in EnvConfig().values().items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        assert env_config(Setting(set=(f'{path}={text}',))) == EnvConfig(), path
    words = (
        'world.spawn.flock_distance_min=30',  # the order of an interval holds for all together
        'world.spawn.flock_distance_max=40',
        'world.flock.metric_attraction=true',
        'lidar.range_noise=0.25',
        'observation.align=goal',
        'noise_std=1',
    )
    config = env_config(Setting(sheep=5, set=words))
    assert (config.world.n_sheep, config.noise_std) == (5, 1.0)
    assert config.world.spawn == SpawnConfig(flock_distance_min=30.0, flock_distance_max=40.0)
    assert config.world.flock == replace(WorldConfig().flock, metric_attraction=True)
    assert config.lidar == LidarConfig(range_noise=0.25)
    assert config.observation.align == 'goal'
    reynolds = env_config(Setting(flock='reynolds', set=('world.flock.max_acceleration=2',)))
    assert reynolds.world.flock == ReynoldsFlock(max_acceleration=2.0)


def test_a_path_and_its_short_name_are_one_setting() -> None:
    words = ('world.n_sheep=7', 'world.flock.sheep_repulsion=1', 'world.dt=0.25')
    setting = canonical_setting(Setting(set=words))
    assert (setting.sheep, setting.repulsion, setting.set) == (7, 1.0, ('world.dt=0.25',))
    assert setting == canonical_setting(Setting(sheep=7, repulsion=1.0, set=('world.dt=0.25',)))
    assert canonical_setting(setting) == setting
    assert describe_setting(setting) == '7 sheep, rho_a 1, world.dt=0.25'
    # not that of the preset
    zero = canonical_setting(Setting(set=('world.flock.sheep_repulsion=0',)))
    assert env_config(zero).world.flock.sheep_repulsion == 0.0
    both = [
        Setting(sheep=7),
        Setting(set=('world.n_sheep=7',)),
        Setting(sheep=7, set=('noise_std=1',)),
    ]
    assert len(plan(both, ['idle'], 0, 1)) == 2


@pytest.mark.parametrize(
    ('word', 'message'),
    [
        ('world.n_shep=5', r"no option 'world.n_shep'; did you mean 'world.n_sheep'\?"),
        ('n_sheep=5', r"did you mean 'world.n_sheep'\?"),
        ('world.flock.max_acceleration=1', "no option 'world.flock.max_acceleration'"),
        ('world.spawn=1', "no option 'world.spawn'"),
        ('world.n_sheep', "set is 'world.n_sheep': expected PATH=VALUE"),
        ('world.n_sheep=many', "world.n_sheep is 'many': expected int, such as 100"),
        ('world.n_sheep=0', r'n_sheep is 0: expected a value in \[1, 10000\]'),
        ('world.flock.metric_attraction=yes', "'yes': expected true or false"),
        ('world.dt=nan', 'dt is nan: expected a finite number'),
        ('observation.align=sheep', "align is 'sheep': expected one of"),
    ],
)
def test_a_word_that_cannot_be_is_named(word: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        env_config(Setting(set=(word,)))


def test_faults_by_path_reach_the_lidar_of_a_policy() -> None:
    policy = make_method('policy:imitation', Setting(set=('lidar.range_noise=0.5',)))
    assert policy.lidar == replace(policy.policy.config.lidar, range_noise=0.5)


def test_record_and_evaluate_take_the_same_options(tmp_path: Path) -> None:
    words = ['--sheep', '3', '--shepherds', '2', '--steps', '4', '--episodes', '1']
    words += ['--set', 'world.shepherd_speed=2', '--set', 'lidar.n_rays=64']
    assert main(['record', '--controller', 'idle', *words, '--out', str(tmp_path / 'bags')]) == 0
    (episode,) = iter_episodes(open_bag(next((tmp_path / 'bags').glob('e*'))))
    setting = Setting(
        sheep=3, shepherds=2, steps=4, set=('world.shepherd_speed=2', 'lidar.n_rays=64')
    )
    assert env_config(setting).world.equals(episode.world)
    assert episode.frames[0].scans[0].shape[-1] == 64
    words += ['--controllers', 'idle', '--out', str(tmp_path / 'rows')]
    assert main(['evaluate', '4', *words]) == 0
    rows = read_results([tmp_path / 'rows'])
    assert rows.in_environment(env_config(setting)).all()
    assert rows.columns['rays'].tolist() == [64]
    assert not rows.in_environment(env_config(replace(setting, set=()))).any()
    chosen = EXPERIMENTS['fig4'].with_changes(('world.shepherd_speed=2', 'lidar.n_rays=64'))
    one = replace(chosen, settings=tuple(replace(s, sheep=3) for s in chosen.settings[:1]))
    assert samples_of(rows, one) is None  # three shepherds
    few = replace(one, settings=(replace(one.settings[0], shepherds=2),), controllers=('idle',))
    found = samples_of(rows, few)
    assert found is not None
    assert found.steps == 4


def test_an_experiment_in_another_task_has_its_flock_and_sheep() -> None:
    moved = EXPERIMENTS['fig5'].in_tasks(('protection', 'herding'))
    assert {(s.task, s.flock, s.sheep) for s in moved.settings} == {
        ('protection', 'crowd', 40), ('herding', 'strombom', 100)
    }  # fmt: skip
    assert len(moved.settings) == 2 * len(EXPERIMENTS['fig5'].settings)
    of_sizes = EXPERIMENTS['fig4'].in_tasks(('protection',)).settings
    assert [s.sheep for s in of_sizes] == [s.sheep for s in EXPERIMENTS['fig4'].settings]
    of_reynolds = EXPERIMENTS['fig8'].in_tasks(('protection',)).settings
    assert {s.flock for s in of_reynolds} == {'reynolds'}
    assert EXPERIMENTS['fig4'].in_tasks(()) is EXPERIMENTS['fig4']
