"""States that a learner visits are bags like any other, from which its labels can be cloned."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shepherd_ros.cli import main
from shepherd_ros.config import ConfigError
from shepherd_ros.datasets.dataset_report import Report
from shepherd_ros.datasets.examples import build_dataset
from shepherd_ros.learning.clone import Examples
from shepherd_ros.learning.dagger import LabelledWorlds
from shepherd_ros.learning.dagger_bags import LABEL_NAMESPACE
from shepherd_ros.learning.dagger_config import DaggerConfig
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.learning.train_bc import BCConfig, stream_examples
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.recordings.check import check_bag
from shepherd_ros.recordings.episodes import iter_episodes
from shepherd_ros.recordings.record import episode_folder
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import ObservationConfig
import torch

STEPS = 9
TASK = TaskConfig(sheep_min=5, sheep_max=7, shepherds_max=3, episode_steps=STEPS, noise_max=0.4)
POLICY = PolicyConfig(
    lidar=LidarConfig(n_rays=64),
    observation=ObservationConfig(frame_interval=1.0, align='goal', unit=10.0),
    network=NetworkConfig(filters_1=2, filters_2=2, hidden=4),
)


def driven(out: Path, worlds: int, steps: int, teacher_drives: bool = False) -> Any:
    """Return policy and examples after a lesson with its bags."""
    torch.manual_seed(1)
    policy = Policy(POLICY)
    config = DaggerConfig(
        task=TASK, worlds=worlds, groups=1, example_interval=1, bag_folder=str(out)
    )
    lesson = LabelledWorlds(config, policy, 0, torch.float32)
    examples = Examples(policy, 1000, torch.float32)
    lesson.run(steps, teacher_drives, examples)
    lesson.close()
    return policy, examples


def test_bc_finds_in_the_bags_what_dagger_learned_from(tmp_path: Path) -> None:
    policy, examples = driven(tmp_path / 'bags', 1, STEPS)
    config = BCConfig(labels=LABEL_NAMESPACE)
    ((frames, first, wanted, hold),) = stream_examples(
        [tmp_path / 'bags'], policy, Report(), config
    )
    assert not hold.any()
    count = len(examples)
    assert len(first) == count >= STEPS
    assert torch.equal(frames, examples.frames[:count])
    assert torch.equal(first, examples.first[:count])
    torch.testing.assert_close(wanted, examples.wanted[:count], atol=1e-6, rtol=0)
    built = tmp_path / 'built'
    build_dataset([tmp_path / 'bags'], built, POLICY.observation, LABEL_NAMESPACE)
    ((_, _, again, _),) = stream_examples([built], policy, Report(), config)
    assert torch.equal(wanted, again)


@pytest.mark.parametrize('teacher_drives', [False, True])
def test_the_commands_are_those_that_moved_the_world(tmp_path: Path, teacher_drives: bool) -> None:
    driven(tmp_path, 2, 2 * STEPS + 4, teacher_drives)
    paths = sorted(tmp_path.iterdir())
    assert len(paths) == 3 * 2  # two whole episodes, and one that was cut
    for path in paths:
        bag = open_bag(path)
        result = check_bag(bag, ('scans', 'commands'))
        assert result.ok, result.text()
        (episode,), (labelled,) = (
            list(iter_episodes(bag)),
            list(iter_episodes(bag, labels=LABEL_NAMESPACE)),
        )
        assert path == episode_folder(tmp_path, episode.seed)
        assert len(episode.frames) == len(labelled.frames)
        assert episode.episode_steps == STEPS
        differ = 0
        for a, b, output in zip(episode.frames, episode.frames[1:], labelled.frames, strict=False):
            command = np.array(a.commands)
            moved = (b.shepherds - a.shepherds) / episode.dt
            np.testing.assert_allclose(moved, command, atol=1e-4)
            differ += not np.array_equal(command, np.array(output.commands))
        assert (differ == 0) == teacher_drives
        assert not any(c is not None for c in episode.frames[-1].commands)
    assert {len(next(iter_episodes(open_bag(p))).frames) for p in paths} == {STEPS + 1, 4 + 1}


def test_the_verbs_write_draw_and_learn_from_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small = ['--policy.lidar.n-rays', '64', '--policy.network.hidden', '4', '--batch-size', '8']
    small += ['--policy.network.filters-1', '2', '--policy.network.filters-2', '2']
    small += [
        '--eval-episodes',
        '2',
        '--eval-steps',
        '2',
        '--sheep-min',
        '5',
        '--sheep-max',
        '5',
    ]
    few = [
        '--rounds',
        '2',
        '--steps-per-round',
        '4',
        '--groups',
        '2',
        '--worlds',
        '1',
        '--updates-per-round',
        '2',
    ]
    words = ['train', 'dagger', '--out', str(tmp_path / 'run'), *few, *small]
    words += ['--episode-steps', '4', '--teacher-rounds', '1', '--teacher-groups', '0']
    assert main([*words, '--bag-folder', str(tmp_path / 'bags')]) == 0
    paths = sorted((tmp_path / 'bags').iterdir())
    assert len(paths) > 2
    assert all((path / f'{path.name}_0.mcap').is_file() for path in paths)
    assert all(main(['bag', 'check', str(path)]) == 0 for path in paths)
    assert main(['bag', 'render', str(paths[0]), '-o', str(tmp_path / 'pictures')]) == 0
    words = ['train', 'bc', str(tmp_path / 'bags'), '--labels', LABEL_NAMESPACE, '--epochs', '1']
    assert main([*words, '--out', str(tmp_path / 'bc'), *small]) == 0
    assert 'examples:' in capsys.readouterr().out


def test_bags_that_are_there_are_not_written_over(tmp_path: Path) -> None:
    driven(tmp_path, 1, 2)
    with pytest.raises(
        ConfigError, match=r'bag_folder is .*: episode_[0-9]+ is there already; choose'
    ):
        driven(tmp_path, 1, 2)
