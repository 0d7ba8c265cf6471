"""Bags written without ROS hold what the environment does."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shepherd_ros.cli import main
from shepherd_ros.cli.record_verb import Record
from shepherd_ros.controllers import make_controller
from shepherd_ros.recordings.check import check_bag
from shepherd_ros.recordings.counterfactual import lidar_of
from shepherd_ros.recordings.episodes import iter_episodes
from shepherd_ros.recordings.record import episode_folder, record_episodes
from shepherd_ros.rosbag2.diff import diff_bags
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.presets import training_world
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import WorldConfig
import tyro

WORLD = replace(WorldConfig(), n_sheep=6, n_shepherds=2, episode_steps=12)
WORDS = ['--sheep', '6', '--shepherds', '2', '--steps', '12']


def test_a_bag_has_the_states_scans_and_commands_of_the_environment(tmp_path: Path) -> None:
    config, controller = EnvConfig(world=WORLD), make_controller('pierson', WORLD)
    record_episodes(config, controller, range(3, 5), tmp_path)
    for seed in (3, 4):
        folder = episode_folder(tmp_path, seed)
        bag, names = open_bag(folder), {path.name for path in folder.iterdir()}
        assert names == {f'{folder.name}_0.mcap', 'metadata.yaml'}
        assert check_bag(bag, ('scans', 'commands')).ok
        (episode,) = iter_episodes(bag)
        assert (episode.seed, len(episode.frames)) == (seed, 13)
        env = ShepherdEnv(config, 1)
        env.reset(seed)
        memory = controller.begin(env.perceived)
        for frame in episode.frames[:-1]:
            assert np.array_equal(frame.sheep, env.state.sheep[0].numpy())
            assert np.array_equal(frame.shepherds, env.state.shepherds[0].numpy())
            action, memory = controller.act(env.perceived, memory)
            for h in range(2):
                assert np.array_equal(frame.scans[h], env.stack[0, h, -1].numpy())
                assert np.array_equal(frame.commands[h], action[0, h].numpy())
            *_, info = env.step(action)
        assert np.array_equal(episode.frames[-1].sheep, info['final_state'].sheep[0].numpy())


def test_an_episode_is_the_same_whatever_is_recorded_beside_it(tmp_path: Path) -> None:
    config, controller = EnvConfig(world=WORLD), make_controller('strombom', WORLD)
    record_episodes(config, controller, range(0, 3), tmp_path / 'a')
    record_episodes(config, controller, range(2, 3), tmp_path / 'b')
    left, right = (open_bag(episode_folder(tmp_path / x, 2)) for x in 'ab')
    assert diff_bags(left, right).equal


def test_training_starts_with_as_many_sheep_as_are_asked_for() -> None:
    def recorded(*words: str) -> int:
        return tyro.cli(Record, args=['--out', 'x', *words]).environment()[0].world.n_sheep

    assert recorded('--training') == 100
    assert recorded('--training', '--sheep', '7') == 7


def test_teams_of_training_have_topics_for_those_present_only(tmp_path: Path) -> None:
    world = replace(training_world(WorldConfig()), n_sheep=5, episode_steps=2)
    record_episodes(EnvConfig(world=world), make_controller('idle', world), range(6), tmp_path)
    teams = set()
    for seed in range(6):
        bag = open_bag(episode_folder(tmp_path, seed))
        (episode,) = iter_episodes(bag)
        named = sum(name.endswith('/cmd_vel') for name in bag.topics)
        assert named == episode.n_shepherds
        teams.add(named)
    assert len(teams) > 1


def test_scans_of_a_policy_are_of_the_lidar_of_its_training(tmp_path: Path) -> None:
    words = ['--task', 'protection', '--sheep', '40', '--shepherds', '2', '--steps', '3']
    drivers = {'policy:escort': 20.0, 'ring': 75.0}
    for name, reach in drivers.items():
        out = tmp_path / name.partition(':')[0]
        words_of = [*words, '--controller', name, '--episodes', '1', '--out', str(out)]
        assert main(['record', *words_of]) == 0
        (episode,) = iter_episodes(open_bag(episode_folder(out, 0)))
        assert {limit for frame in episode.frames for limit, _ in frame.lidars} == {reach}
        assert lidar_of(episode) == LidarConfig(range_max=reach)
        (first, *_) = episode.frames
        pedestrians = [scan[0] for scan in first.scans if scan is not None]
        assert len(pedestrians) == 2
        seen = np.concatenate([ranges[np.isfinite(ranges)] for ranges in pedestrians])
        assert (seen.max() <= 20.0) == (reach == 20.0)


@pytest.mark.system
def test_the_verb_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    out = tmp_path / 'bags'
    assert main(['record', '--out', str(out), '--episodes', '2', *WORDS]) == 0
    first = (episode_folder(out, 0) / 'metadata.yaml').stat().st_mtime_ns
    (out / '.episode_000002').mkdir()  # as a killed run leaves it
    assert main(['record', '--out', str(out), '--episodes', '3', '--workers', '2', *WORDS]) == 0
    assert sorted(path.name for path in out.glob('e*')) == [f'episode_{k:06d}' for k in range(3)]
    assert (episode_folder(out, 0) / 'metadata.yaml').stat().st_mtime_ns == first
    assert all(check_bag(open_bag(folder)).ok for folder in out.glob('e*'))


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['--controller', 'dog'], "controller is 'dog'"),
        (['--workers', '0'], '--workers is 0: expected at least 1'),
        (['--sheep', '0'], 'n_sheep is 0: expected a value in'),
    ],
)
def test_a_mistake_is_named_before_anything_is_written(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['record', '--out', str(tmp_path / 'x'), *words]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / 'x').exists()


def test_a_folder_that_cannot_be_made_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'file').touch()
    assert main(['record', '--out', str(tmp_path / 'file' / 'x'), *WORDS]) == 2
    assert 'expected a folder' in capsys.readouterr().err
