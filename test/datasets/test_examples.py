"""Data sets in Parquet: the same examples as from the bags, in little memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import json
from pathlib import Path
import shutil
from typing import Any
from weakref import WeakSet

import numpy as np
import pandas
import pyarrow as pa
from pyarrow import parquet
import pytest
from shepherd_ros.cli import main
from shepherd_ros.config import ConfigError
from shepherd_ros.controllers import make_controller
from shepherd_ros.datasets import examples
from shepherd_ros.datasets.dataset_report import Report
from shepherd_ros.datasets.examples import (
    bag_folders,
    build_dataset,
    count_examples,
    stream_steps,
)
from shepherd_ros.datasets.lerobot_format import DATA_PATH, EPISODES_PATH
from shepherd_ros.datasets.lerobot_reader import open_dataset
from shepherd_ros.datasets.lerobot_writer import DatasetWriter, runs
from shepherd_ros.datasets.running_stats import RunningStats
from shepherd_ros.datasets.steps import Steps, steps_of
from shepherd_ros.learning.train_bc import BCConfig, stream_examples
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.recordings.episodes import iter_episodes, RecordedEpisode
from shepherd_ros.recordings.record import record_episodes
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import ObservationConfig
from shepherd_ros.sim.presets import training_world, world_preset
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import WorldConfig
import torch

RAYS, STEPS, EPISODES_MADE = 64, 12, 4
WORLD = replace(training_world(WorldConfig()), n_sheep=9, episode_steps=STEPS)
OBSERVATION = ObservationConfig(frame_interval=1.5, align='goal', unit=10.0)
POLICY = PolicyConfig(
    lidar=LidarConfig(n_rays=RAYS),
    observation=OBSERVATION,
    network=NetworkConfig(filters_1=2, filters_2=2, hidden=4),
)


def quiet(reason: str, where: str, count: int) -> None:
    """Refuse without a word."""


@pytest.fixture(scope='module')
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp('bags')
    config = EnvConfig(world=WORLD, lidar=POLICY.lidar)
    record_episodes(config, make_controller('drover', WORLD), range(EPISODES_MADE), out)
    return out


@pytest.fixture
def holes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every episode that is read from a bag lack a state, a scan and a command."""

    def torn(*arguments: Any, **options: Any) -> Any:
        for episode in iter_episodes(*arguments, **options):
            frames = list(episode.frames)
            frames[4] = replace(frames[4], commands=[None, *frames[4].commands[1:]])
            frames[7] = replace(frames[7], scans=[*frames[7].scans[:-1], None])
            del frames[9]
            yield replace(episode, frames=frames)

    monkeypatch.setattr(examples, 'iter_episodes', torn)


def read_examples(place: Path, policy: Policy, seed: int | None = None) -> list[Any]:
    return list(stream_examples([place], policy, Report(), BCConfig(), seed))


@pytest.mark.parametrize('seed', [None, 3])
def test_a_built_folder_gives_the_examples_of_its_bags(
    bags: Path, tmp_path: Path, seed: int | None
) -> None:
    policy = Policy(POLICY)
    report = build_dataset([bags], tmp_path / 'built', OBSERVATION)
    left, right = (read_examples(place, policy, seed) for place in (bags, tmp_path / 'built'))
    assert len(left) == len(right) == EPISODES_MADE
    assert sum(len(first) for _, first, *_ in left) == report.examples == report.steps
    for one, other in zip(left, right, strict=True):
        for a, b in zip(one, other, strict=True):
            assert torch.equal(a, b)
            assert a.dtype == b.dtype


@pytest.mark.usefixtures('holes')
def test_recordings_with_holes_give_the_same_examples_too(bags: Path, tmp_path: Path) -> None:
    policy = Policy(POLICY)
    report = build_dataset([bags], tmp_path / 'built', OBSERVATION)
    assert {'no poses', 'no command', 'no scan', 'an earlier frame is missing'} == set(
        report.drops
    )
    teams = sum(team * count for team, count in report.shepherds.items())
    assert report.drops['no command'] == report.drops['no scan'] == EPISODES_MADE
    assert report.drops['no poses'] == teams
    assert report.first_drop['no scan'].startswith('episode_000000:0, step 7, shepherd_')
    assert report.steps == teams * STEPS == report.examples + sum(report.drops.values())
    built = open_dataset(tmp_path / 'built')
    assert (built.runs['length'] < STEPS).any()
    for one, other in zip(
        read_examples(bags, policy), read_examples(tmp_path / 'built', policy), strict=True
    ):
        assert all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


def test_a_built_folder_has_the_files_and_columns_of_lerobot(bags: Path, tmp_path: Path) -> None:
    out = tmp_path / 'built'
    report = build_dataset([bags], out, OBSERVATION)
    info = json.loads((out / 'meta/info.json').read_text())
    assert (info['codebase_version'], info['fps'], info['total_frames']) == (
        'v3.0',
        2,
        report.steps,
    )
    table = parquet.read_table(out / info['data_path'].format(chunk_index=0, file_index=0))
    assert table.column_names == list(info['features'])
    assert info['features']['observation.lidar']['shape'] == [3, RAYS]
    columns = {name: table[name].to_numpy() for name in table.column_names[2:]}
    assert np.array_equal(columns['index'], np.arange(report.steps))
    assert (columns['task_index'] == 0).all()
    np.testing.assert_allclose(columns['timestamp'], columns['frame_index'] * 0.5)
    episodes = parquet.read_table(out / EPISODES_PATH).to_pylist()
    assert len(episodes) == info['total_episodes'] == columns['episode_index'].max() + 1
    for k, row in enumerate(episodes):
        own = slice(row['dataset_from_index'], row['dataset_to_index'])
        assert (columns['episode_index'][own] == k).all()
        assert np.array_equal(columns['frame_index'][own], np.arange(row['length']))
        assert row['tasks'] == ['herd the flock into the goal']
        assert row['bag'] == f'episode_{row["seed"]:06d}'
    tasks = pandas.read_parquet(out / 'meta/tasks.parquet')  # as LeRobot does
    assert tasks.to_dict('index') == {'herd the flock into the goal': {'task_index': 0}}
    stats = json.loads((out / 'meta/stats.json').read_text())
    action = np.array(table['action'].to_pylist())
    np.testing.assert_allclose(stats['action']['mean'], action.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(stats['action']['std'], action.std(axis=0), atol=1e-6)
    lidar = np.array(table['observation.lidar'].to_pylist())
    assert lidar.shape == (report.steps, 3, RAYS)
    seen = lidar[:, 2][np.isfinite(lidar[:, 2])]
    np.testing.assert_allclose(stats['observation.lidar']['max'][2], seen.max(), atol=1e-6)
    about = json.loads((out / 'meta/shepherd_ros.json').read_text())
    assert about['report'] == json.loads(json.dumps(report.to_dict()))
    assert [path.name for path in tmp_path.iterdir()] == ['built']


def test_each_run_has_the_task_of_its_episode(bags: Path, tmp_path: Path) -> None:
    herd = 'herd the flock into the goal'
    guard = 'keep a moving crowd away from a payload that travels to its destination'
    preset = world_preset(task='protection')
    world = replace(preset, n_sheep=5, n_shepherds=2, episode_steps=3, dt=WORLD.dt)
    config = EnvConfig(world=world, lidar=POLICY.lidar)
    crowd = tmp_path / 'crowd'
    record_episodes(config, make_controller('ring', world), range(1), crowd)
    build_dataset([bags, crowd], tmp_path / 'both', OBSERVATION)
    build_dataset([crowd], tmp_path / 'one', OBSERVATION)
    build_dataset([tmp_path / 'both'], tmp_path / 'again', OBSERVATION)  # of a data set
    for name, texts in (('both', [herd, guard]), ('one', [guard]), ('again', [herd, guard])):
        out = tmp_path / name
        tasks = pandas.read_parquet(out / 'meta/tasks.parquet')['task_index'].to_dict()
        assert tasks == {text: k for k, text in enumerate(texts)}
        info = json.loads((out / 'meta/info.json').read_text())
        assert info['total_tasks'] == len(texts)
        path = out / info['data_path'].format(chunk_index=0, file_index=0)
        index = parquet.read_table(path)['task_index'].to_numpy()
        for row in parquet.read_table(out / EPISODES_PATH).to_pylist():
            (text,) = row['tasks']
            assert text == (guard if row['n_sheep'] == 5 else herd)
            own = slice(row['dataset_from_index'], row['dataset_to_index'])
            assert (index[own] == tasks[text]).all()
    # a task of a plug-in that is not here is called by its name
    episode = next(iter_episodes(open_bag(bag_folders(bags)[0])))
    fetch = replace(episode, world={**episode.world, 'task': {'name': 'fetch'}})
    assert steps_of(fetch, 'x', 0, quiet).task == 'fetch'


def test_full_files_are_followed_by_others(bags: Path, tmp_path: Path) -> None:
    with DatasetWriter(tmp_path / 'built', file_size=2 * STEPS * 3 * RAYS * 4) as writer:
        for source, steps in stream_steps([bags], Report()):
            writer.begin_bag(source.name)
            writer.add(steps)
        writer.close({})
    assert writer.files > 3
    assert (
        tmp_path / 'built' / DATA_PATH.format(chunk_index=0, file_index=writer.files - 1)
    ).exists()
    policy = Policy(POLICY)
    for one, other in zip(
        read_examples(bags, policy), read_examples(tmp_path / 'built', policy), strict=True
    ):
        assert all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


def counted(kind: type, alive: WeakSet[Any], most: list[int]) -> Callable[..., None]:
    """Return an __init__ that counts how many of a kind are alive at once."""
    before = kind.__init__

    def init(self: Any, *arguments: Any, **options: Any) -> None:
        before(self, *arguments, **options)
        alive.add(self)
        most.append(len(alive))

    return init


def test_few_episodes_are_in_memory_at_once(
    bags: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    many = tmp_path / 'many'
    many.mkdir()
    for k in range(10):
        for path in bags.iterdir():
            (many / f'{path.name}_{k}').symlink_to(path)
    alive: dict[type, list[int]] = {RecordedEpisode: [], Steps: []}
    for kind, most in alive.items():
        # a frozen data class has no hash of its arrays
        monkeypatch.setattr(kind, '__hash__', object.__hash__)
        monkeypatch.setattr(kind, '__init__', counted(kind, WeakSet(), most))
    report = build_dataset([many], tmp_path / 'built', OBSERVATION)
    assert report.episodes == 10 * EPISODES_MADE
    assert {kind: (len(most), max(most) <= 2) for kind, most in alive.items()} == {
        RecordedEpisode: (report.episodes, True),
        Steps: (report.episodes, True),
    }
    alive[Steps].clear()
    assert count_examples([tmp_path / 'built'], OBSERVATION).examples == report.examples
    assert (len(alive[Steps]), max(alive[Steps]) <= 2) == (report.episodes, True)


def test_runs_end_at_holes_and_at_shepherds() -> None:
    steps = Steps(
        bag='b', episode=0, seed=0, n_sheep=1, n_shepherds=2, dt=0.5,
        step=np.array([0, 0, 1, 3, 3, 4]), shepherd=np.array([0, 1, 1, 0, 1, 0]),
        lidar=np.zeros((6, 3, 4), np.float32), action=np.zeros((6, 2), np.float32),
    )  # fmt: skip
    assert [run.tolist() for run in runs(steps)] == [[0], [3, 5], [1, 2], [4]]


def test_a_command_that_single_precision_cannot_hold_is_refused(bags: Path) -> None:
    (episode,) = iter_episodes(open_bag(bags / 'episode_000000'))
    frames = list(episode.frames)
    for k, value in ((1, 1e300), (2, np.nan)):
        odd = [np.array([value, 0.0]), *frames[k].commands[1:]]
        frames[k] = replace(frames[k], commands=odd)
    scan = frames[3].scans[0].copy()
    scan[1, 2] = np.nan
    frames[3] = replace(frames[3], scans=[scan, *frames[3].scans[1:]])
    report = Report()
    steps_of(replace(episode, frames=frames), 'bag', 0, report.refuse)
    assert report.drops == {'a command that is not finite': 2, 'a scan with NaN': 1}
    other = replace(frames[5], scans=[np.zeros((3, 7), np.float32)] * episode.n_shepherds)
    with pytest.raises(ConfigError, match='step 5, shepherd_0: a scan of 7 rays, expected 64'):
        steps_of(replace(episode, frames=[*frames[:5], other, *frames[6:]]), 'bag', 0, quiet)


def test_spread_by_hand() -> None:
    spread = RunningStats(2)
    assert spread.to_dict() == {name: [0, 0] for name in ('mean', 'std', 'min', 'max')}
    spread.add([[1.0, np.inf], [3.0, -2.0]])
    spread.add([[5.0, np.nan]])
    found = spread.to_dict()
    assert found['mean'] == [3.0, -2.0]
    assert found['std'] == pytest.approx([(8 / 3) ** 0.5, 0.0])
    assert (found['min'], found['max']) == ([1.0, -2.0], [5.0, -2.0])


# ---- the verbs ----


def test_info_tells_what_is_there(bags: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['dataset', 'info', str(bags), '--frame-interval', '1.5', '--json']) == 0
    data = json.loads(capsys.readouterr().out)
    report = count_examples([bags], OBSERVATION)
    assert data == json.loads(json.dumps(report.to_dict()))
    actions, shares, teams = [], [], []
    for path in bags.iterdir():
        (episode,) = iter_episodes(open_bag(path))
        teams.append(episode.n_shepherds)
        for frame in episode.frames[:-1]:
            actions += frame.commands
            shares += [np.isfinite(scan[2]).mean() for scan in frame.scans]
    speed = np.linalg.norm(actions, axis=1)
    for name in ('mean', 'std', 'min', 'max'):
        assert data['speed'][name] == pytest.approx(getattr(speed, name)(), abs=1e-6)
        expected = getattr(np.array(shares), name)()
        assert data['returns']['goal'][name] == pytest.approx(expected, abs=1e-6)
    assert data['episodes_by_shepherds'] == {str(n): teams.count(n) for n in sorted(set(teams))}
    assert data['episodes_by_sheep'] == {'9': EPISODES_MADE}
    assert main(['dataset', 'info', str(bags)]) == 0
    text = capsys.readouterr().out
    for words in (
        'examples:',
        'speed [m/s]',
        'rays that hit, goal',
        'shepherds  episodes',
        '####',
    ):
        assert words in text


def test_many_sizes_share_a_bar() -> None:
    report = Report()
    report.sheep.update(dict.fromkeys(range(10, 201), 1))
    lines = [line.split() for line in report.text().splitlines() if '#' in line]
    assert len(lines) <= 12
    assert sum(int(row[1]) for row in lines) == 191
    assert lines[0][0] == '10-25'
    assert lines[-1][0].endswith('-200')


def test_bc_learns_the_same_from_a_built_folder(bags: Path, tmp_path: Path) -> None:
    built = tmp_path / 'built'
    assert main(['dataset', 'build', str(bags), '--out', str(built)]) == 0
    words = ['--epochs', '1', '--eval-episodes', '2', '--eval-steps', '2', '--batch-size', '16']
    words += ['--policy.lidar.n-rays', str(RAYS), '--policy.network.hidden', '4']
    words += ['--policy.network.filters-1', '2', '--policy.network.filters-2', '2']
    losses = []
    for name, place in (('bags', bags), ('built', built)):
        out = tmp_path / name / 'run'
        assert main(['train', 'bc', str(place), '--out', str(out), *words]) == 0
        losses.append(json.loads((out / 'curve.jsonl').read_text())['loss'])
    assert losses[0] == losses[1]


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['info'], 'no bags are given'),
        (['info', '{tmp}'], 'expected a bag, a folder of bags'),
        (['info', '{tmp}/none'], 'expected a bag, a folder of bags'),
        (
            ['info', '{bags}', '--frame-interval', '0'],
            'frame_interval is 0.0: expected a value in',
        ),
        (['info', '{bags}', '--labels', 'teacher'], "labels is 'teacher', but it has no topic"),
        (['build', '{bags}', '--out', '{bags}'], 'it exists already'),
        (['build', '{bags}', '--out', '/proc/no/where'], 'it cannot be written'),
    ],
)
def test_a_mistake_is_named(
    words: list[str], message: str, bags: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    filled = [word.format(tmp=tmp_path, bags=bags) for word in words]
    assert main(['dataset', *filled]) == 2
    assert message in capsys.readouterr().err


def test_scans_that_begin_at_another_angle_are_refused(bags: Path) -> None:
    episode = next(iter_episodes(open_bag(bag_folders(bags)[0])))
    lidars = frozenset({(75.0, 1.5708)})
    turned = replace(episode, frames=[replace(f, lidars=lidars) for f in episode.frames])
    with pytest.raises(ConfigError, match=r'x:0: scans have angle_min 1\.5708 rad, expected 0'):
        steps_of(turned, 'x', 0, lambda reason, place, steps: None)


def test_bags_of_two_kinds_make_no_data_set(bags: Path, tmp_path: Path) -> None:
    world = replace(WORLD, episode_steps=3)
    other = EnvConfig(world=world, lidar=LidarConfig(n_rays=16))
    record_episodes(other, make_controller('idle', world), range(1), tmp_path / 'few')
    with pytest.raises(BagError, match=r'16 rays, expected 0\.5 s and 64 as in the bags before'):
        build_dataset([bags, tmp_path / 'few'], tmp_path / 'built', OBSERVATION)
    assert sorted(path.name for path in tmp_path.iterdir()) == ['few']


def test_labels_of_a_built_folder_have_to_be_those_asked_for(bags: Path, tmp_path: Path) -> None:
    build_dataset([bags], tmp_path / 'built', OBSERVATION)
    with pytest.raises(ConfigError, match="its labels are '', expected 'teacher'"):
        count_examples([tmp_path / 'built'], OBSERVATION, 'teacher')


def test_bags_are_found_with_and_without_metadata(bags: Path, tmp_path: Path) -> None:
    for name in ('b', 'a', '.killed'):
        shutil.copytree(bags / 'episode_000000', tmp_path / name)
    (tmp_path / 'a' / 'metadata.yaml').unlink()
    (tmp_path / 'notes').mkdir()
    assert [path.name for path in bag_folders(tmp_path)] == ['a', 'b']
    (file,) = (tmp_path / 'a').glob('*.mcap')
    assert bag_folders(tmp_path / 'a') == [tmp_path / 'a']
    assert bag_folders(file) == [file]


def test_a_data_set_of_others_is_refused(bags: Path, tmp_path: Path) -> None:
    out = tmp_path / 'built'
    build_dataset([bags], out, OBSERVATION)
    table = parquet.read_table(out / EPISODES_PATH)
    first = table.column_names.index('length')
    odd = table.set_column(first, 'length', pa.array([10**9] * len(table)))
    parquet.write_table(odd, out / EPISODES_PATH)
    with pytest.raises(BagError, match='length is 1000000000, expected 1 to 10000000'):
        count_examples([out], OBSERVATION)
    (out / 'meta/shepherd_ros.json').unlink()
    with pytest.raises(BagError, match='so it is no data set of ours'):
        count_examples([out], OBSERVATION)
