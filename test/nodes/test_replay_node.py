"""Recordings prove something: of two runs, of the core, of a controller, and of a future."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from itertools import islice
from pathlib import Path
import shutil

from nodes.process import Graph
import numpy as np
import pytest
from shepherd_ros.cli import main, processes
from shepherd_ros.controllers import make_controller
from shepherd_ros.nodes import controller_probe
from shepherd_ros.recordings.check import check_bag
from shepherd_ros.recordings.counterfactual import record_future
from shepherd_ros.recordings.episodes import iter_episodes
from shepherd_ros.recordings.record import episode_folder, record_episodes
from shepherd_ros.rosbag2.diff import diff_bags
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.sim.metrics import METRICS
from shepherd_ros.sim.presets import world_preset
from shepherd_ros.sim.rollout import EnvConfig
from std_srvs.srv import SetBool

pytestmark = [
    pytest.mark.system,
    pytest.mark.xdist_group('replay'),  # one worker records the runs, once
]

STEPS, SEED, NOISE, TEAM = 25, 3, 0.3, 2
SMALL = {'n_sheep': 10, 'n_shepherds': TEAM, 'episode_steps': STEPS}
WORLD = replace(world_preset('default'), **SMALL)
SHOWN = 1  # times that the first state is shown at least once everybody listens
TOPICS = ['/clock', '/episode', '/goal', '/flock/poses', '/shepherds/poses']
TOPICS += [f'/shepherd_{h}/scan/{c}' for h in range(TEAM) for c in ('sheep', 'shepherds', 'goal')]
TOPICS += [f'/shepherd_{h}/cmd_vel' for h in range(TEAM)]
TOPICS += [f'/metrics/{name}' for name in METRICS]
FRAME = ('stamp_ns', 'sheep', 'sheep_heading', 'shepherds', 'shepherd_heading', 'goal')
Graphs = Callable[[Path], AbstractContextManager[Graph]]
Said = tuple[int, str, str]


def record_run(graph: Graph, folder: Path, controller: str, episodes: int = 1) -> Path:
    """Record a whole run in lockstep, every topic that two runs of a seed have alike."""
    words = ['-o', str(folder), '-x', 'markers|/diagnostics|/tf']
    recorder = graph.start_words('recorder', ['-v', *words])
    graph.until_nodes('recorder')
    sim = graph.start(
        'flock_sim', seed=SEED, episodes=episodes, wait_for_scans=True, silence_warning=60.0,
        **SMALL,
    )  # fmt: skip
    assert graph.call('/flock_sim/pause', SetBool, SetBool.Request(data=True)).success
    others = [
        graph.start('lidar', shepherd_ids=list(range(TEAM)), noise_std=NOISE),
        graph.start('metrics'),
        graph.start(controller, noise_std=NOISE),
    ]
    for topic in TOPICS:
        graph.until_says(recorder, f'recording {topic} ')
    track = graph.track()
    graph.until(lambda: len(track.shown) > SHOWN, 'a paused world shows its state')
    assert graph.call('/flock_sim/pause', SetBool, SetBool.Request(data=False)).success
    assert sim.wait() == 0, sim
    graph.until_says(others[1], f'episode {episodes - 1}, seed {SEED + episodes - 1}: ')
    assert recorder.stop() == 0, recorder
    for process in others:
        assert process.stop() == 0, process
    return folder


@pytest.fixture(scope='module')
def runs(graphs: Graphs, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Record two runs that should be the same."""
    bags = []
    for name in 'ab':
        folder = tmp_path_factory.mktemp(name)
        with graphs(folder) as graph:
            bags.append(record_run(graph, folder / 'bag', 'pierson'))
    return bags


@pytest.fixture(scope='module')
def row(graphs: Graphs, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record two episodes in a row."""
    folder = tmp_path_factory.mktemp('row')
    with graphs(folder) as graph:
        return record_run(graph, folder / 'bag', 'strombom', 2)


@pytest.fixture
def shepherd(
    shared_graph: Graph,
    commands: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> Callable[..., Said]:
    """Return what runs a verb: exit code, stdout and stderr."""
    monkeypatch.setenv('PATH', str(commands), prepend=':')
    monkeypatch.setattr(processes, 'executable', lambda name: str(shutil.which(name)))

    def run(*words: object) -> Said:
        code = main([str(word) for word in words])
        output = capsys.readouterr()
        return code, output.out, output.err

    return run


# ---- determinism ----


def test_two_runs_of_one_seed_say_the_same(
    runs: list[Path], shepherd: Callable[..., Said]
) -> None:
    for bag in runs:
        result = check_bag(open_bag(bag), ('scans', 'commands'))
        assert result.ok, result.text()
    code, out, _ = shepherd('bag', 'diff', *runs, '--once')
    assert code == 0, out
    assert sorted(line.partition(':')[0] for line in out.splitlines()[:-1]) == sorted(TOPICS)


@pytest.fixture(scope='module')
def pure(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record the same episode without ROS."""
    folder = tmp_path_factory.mktemp('pure')
    config, law = EnvConfig(world=WORLD, noise_std=NOISE), make_controller('pierson', WORLD)
    record_episodes(config, law, range(SEED, SEED + 1), folder)
    return episode_folder(folder, SEED)


def test_a_run_says_what_shepherd_record_writes_without_ros(
    runs: list[Path], pure: Path, shepherd: Callable[..., Said]
) -> None:
    code, out, _ = shepherd('bag', 'diff', runs[0], pure, '--once')
    assert code == 0, out
    run, written = open_bag(runs[0]), open_bag(pure)
    assert set(run.topics) == set(written.topics) == set(TOPICS)
    assert run.schemas == written.schemas
    for name, topic in run.topics.items():
        other = written.topics[name]
        assert (topic.type, topic.type_hash) == (other.type, other.type_hash), name
        assert topic.serialization == other.serialization == 'cdr'
        offers = [[(q.reliability, q.durability) for q in t.qos] for t in (topic, other)]
        assert offers[0] == offers[1], name
    assert diff_bags(run, written, once=True).equal


# ---- a controller is asked again ----


@pytest.mark.parametrize('without_ros', [False, True])
def test_the_recorded_controller_says_the_same_again(
    runs: list[Path], row: Path, without_ros: bool, shepherd: Callable[..., Said]
) -> None:
    route = ['--without-ros'] if without_ros else []
    for bag, controller, episodes in ((runs[0], 'pierson', 1), (row, 'strombom', 2)):
        words = ['replay', bag, '--controller', controller, '-p', f'noise_std:={NOISE}', *route]
        code, out, err = shepherd(*words)
        assert (code, err) == (0, ''), out
        n = episodes * TEAM * (STEPS + 1)
        assert f'{n} commands of {episodes} episodes compared: {n} equal, 0 differ' in out


@pytest.mark.parametrize(
    'words',
    [
        ['--controller', 'pierson', '-p', 'max_turn_rate:=0.1', '--tolerance', '0.05'],
        ['--controller', 'random', '--shepherds', '1'],
    ],
)
def test_node_and_law_differ_from_the_recording_in_the_same_way(
    words: list[str], pure: Path, shepherd: Callable[..., Said]
) -> None:
    code, out, err = shepherd('replay', pure, *words)
    assert (code, err) == (1, ''), out
    assert 'first difference: episode 0, step ' in out
    assert shepherd('replay', pure, *words, '--without-ros') == (1, out, '')


def test_a_shepherd_that_is_not_answered_for_is_missing(
    pure: Path, monkeypatch: pytest.MonkeyPatch, shepherd: Callable[..., Said]
) -> None:
    monkeypatch.setattr(controller_probe, 'TEAM_TIMEOUT', 0.5)
    words = ['--controller', 'pierson', '-p', f'noise_std:={NOISE}', 'shepherd_ids:=[1]']
    code, out, _ = shepherd('replay', pure, *words)
    assert code == 1
    n = STEPS + 1
    assert f'{n} commands of 1 episodes compared: {n} equal, 0 differ' in out
    assert f'missing: {n} commands; episode 0, step 0, stamp 0.500000000 s, shepherd_0: ' in out
    assert shepherd('replay', pure, *words, '--shepherds', '1')[0] == 0


def script(folder: Path, text: str) -> str:
    """Write an executable; return its name."""
    path = folder / 'dog'
    path.write_text(f'#!/bin/sh\n{text}\n')
    path.chmod(0o755)
    return path.name


def test_a_controller_that_is_silent_has_said_nothing(
    pure: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shepherd: Callable[..., Said]
) -> None:
    monkeypatch.setenv('PATH', str(tmp_path), prepend=':')
    monkeypatch.setattr(controller_probe, 'ANSWER_TIMEOUT', 0.5)
    code, out, _ = shepherd('replay', pure, '--controller', script(tmp_path, 'exec sleep 60'))
    assert code == 1
    place = 'episode 0, step 0, stamp 0.500000000 s, shepherd_0: no command from the controller'
    assert f'missing: {TEAM * (STEPS + 1)} commands; {place}' in out


def test_a_controller_that_dies_is_quoted(
    pure: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shepherd: Callable[..., Said]
) -> None:
    monkeypatch.setenv('PATH', str(tmp_path), prepend=':')
    dog = script(tmp_path, 'echo no bone today; exit 3')
    code, out, err = shepherd('replay', pure, '--controller', dog)
    assert (code, out) == (2, '')
    assert 'dog ended with exit code 3:\nno bone today' in err


# ---- another future ----


@pytest.mark.parametrize(('episode', 'at'), [(0, 12), (1, 0), (1, 17)])
def test_the_recorded_controller_makes_the_recorded_future_of_a_run(
    row: Path, tmp_path: Path, episode: int, at: int
) -> None:
    recorded = next(islice(iter_episodes(open_bag(row)), episode, None))
    law = make_controller('strombom', WORLD)
    assert record_future(recorded, at, law, NOISE, tmp_path / 'again') == (at > 0)
    (again,) = iter_episodes(open_bag(tmp_path / 'again'))
    assert again.to_json() == recorded.to_json()
    for one, other in zip(recorded.frames, again.frames, strict=True):
        for name in (
            'stamp_ns',
            'sheep',
            'sheep_heading',
            'shepherds',
            'shepherd_heading',
            'goal',
        ):
            assert np.array_equal(getattr(one, name), getattr(other, name)), (one.step, name)
        for h in range(TEAM):
            assert np.array_equal(one.commands[h], other.commands[h])
            assert np.array_equal(one.scans[h], other.scans[h])
