"""A bag shows what the environment did."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shepherd_ros.cli import main
from shepherd_ros.controllers import make_controller
from shepherd_ros.experiments.runner import run_episodes
from shepherd_ros.recordings.episodes import iter_episodes
from shepherd_ros.recordings.record import episode_folder, record_episodes
from shepherd_ros.recordings.replay import metrics_over_time, ranges_of, states_of, track_of
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import WorldConfig

WORLD = replace(WorldConfig(), n_sheep=5, n_shepherds=2, episode_steps=8)


@pytest.fixture()
def bag(tmp_path: Path) -> Path:
    controller = make_controller('pierson', WORLD)
    record_episodes(EnvConfig(world=WORLD), controller, range(4, 5), tmp_path)
    return episode_folder(tmp_path, 4)


def test_the_metrics_of_a_bag_are_those_of_the_environment(bag: Path) -> None:
    (episode,) = iter_episodes(open_bag(bag))
    curves = metrics_over_time(states_of(episode), episode.episode_steps)
    result = run_episodes(EnvConfig(world=WORLD), make_controller('pierson', WORLD), 4, 1)
    for name, values in curves.items():
        assert values.shape == (9,)
        assert values[-1] == float(result[name][0]), name


def test_the_track_has_what_was_recorded(bag: Path) -> None:
    (episode,) = iter_episodes(open_bag(bag))
    track, ranges = track_of(episode, 'a title'), ranges_of(episode)
    assert np.array_equal(track.sheep[3], episode.frames[3].sheep)
    assert np.array_equal(ranges[3, 1], episode.frames[3].scans[1])
    assert (track.title, track.goal_radius) == ('a title', 4.0)


def test_render_writes_picture_animation_and_page(bag: Path, tmp_path: Path) -> None:
    assert main(['bag', 'render', str(bag), '-o', str(tmp_path / 'out')]) == 0
    sizes = {path.name: path.stat().st_size for path in (tmp_path / 'out').iterdir()}
    assert set(sizes) == {'tracks.png', 'herding.gif', 'replay.html'}
    assert min(sizes.values()) > 10_000


@pytest.mark.parametrize(
    ('words', 'message'),
    [(['--episode', '3'], '--episode is 3: expected an episode'), (['-o', 'x/y'], 'a folder')],
)
def test_a_mistake_is_named(
    bag: Path, words: list[str], message: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path('x').touch()
    assert main(['bag', 'render', str(bag), '-o', 'out', *words]) == 2
    assert message in capsys.readouterr().err
