"""A person takes a shepherd while a controller drives the others: recorded, and learned from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import re
from typing import Any

from geometry_msgs.msg import TwistStamped
from nodes.process import Graph, LATCHED, twist
import numpy as np
import pyarrow.parquet as parquet
import pytest
from sensor_msgs.msg import LaserScan
from shepherd_ros.cli import main
from shepherd_ros.config import ConfigError
from shepherd_ros.datasets.dataset_report import Report
from shepherd_ros.datasets.examples import build_dataset, examples_of, stream_steps
from shepherd_ros.datasets.lerobot_format import EPISODES_PATH
from shepherd_ros.learning import train_bc as training
from shepherd_ros.learning.clone import CloneConfig, Examples
from shepherd_ros.learning.run_folder import RunFolder
from shepherd_ros.learning.validation import EvaluationConfig
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.recordings.check import check_bag
from shepherd_ros.recordings.episodes import iter_episodes, RecordedEpisode
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import ObservationConfig
from std_msgs.msg import String
from std_srvs.srv import SetBool
import torch

pytestmark = pytest.mark.xdist_group('interventions')  # one bag for all
RAYS, STEPS = 32, 24
OBSERVATION = ObservationConfig(frame_interval=1.0, align='goal', unit=10.0)
POLICY = PolicyConfig(
    lidar=LidarConfig(n_rays=RAYS),
    observation=OBSERVATION,
    network=NetworkConfig(filters_1=2, filters_2=2, hidden=4),
)
BY_HAND = (0.25, -0.5)  # m/s


@pytest.fixture(scope='module')
def bag(shared_graph: Graph, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record an episode in which keys drive shepherd_1 from about a third to two thirds of it."""
    graph, folder = shared_graph, tmp_path_factory.mktemp('taken') / 'bag'
    recorder = graph.start_words('recorder', ['-v', '-o', str(folder), '-x', '/diagnostics'])
    graph.until_says(recorder, 'listening')
    world = {'n_sheep': 4, 'n_shepherds': 2, 'episode_steps': STEPS, 'episodes': 1}
    sim = graph.host('flock_sim', wait_for_scans=True, **world)
    assert graph.call('flock_sim/pause', SetBool, SetBool.Request(data=True)).success
    graph.host('lidar', shepherd_ids=[0, 1], n_rays=RAYS)
    keys_are = {'topics.keys.frame': 'world', 'topics.keys.timeout': 60.0}
    graph.host('mux', default='strombom', **keys_are)
    graph.host('strombom', source='strombom')
    keys = graph.publisher('shepherd_1/cmd_vel/keys', TwistStamped, readers=2)
    printed = graph.collect('drivers', String, LATCHED)
    topics = ['episode', 'goal', 'flock/poses', 'shepherds/poses', 'drivers']
    for h in range(2):
        topics += [f'shepherd_{h}/{name}' for name in ('cmd_vel', 'cmd_vel/strombom')]
        topics += [f'shepherd_{h}/scan/{name}' for name in ('sheep', 'shepherds', 'goal')]
    for topic in topics:
        graph.until_says(recorder, f'recording /{topic} ')
    # what was published before the recorder listened is published again with the paused state
    again = [graph.collect(f'shepherd_{h}/scan/goal', LaserScan) for h in range(2)]
    again += [graph.collect(f'shepherd_{h}/cmd_vel', TwistStamped) for h in range(2)]
    graph.until(lambda: all(len(messages) >= 2 for messages in again), 'the first state again')
    for _ in range(STEPS // 3):
        advance(graph, sim)
    keys.publish(twist(0, *BY_HAND))
    graph.until(lambda: graph.hosted[-2].mux.states[1]['keys'].received > 0, 'a key')
    for _ in range(STEPS // 3):
        advance(graph, sim)
    graph.trigger('shepherd_1/mux/strombom')
    assert graph.call('flock_sim/pause', SetBool, SetBool.Request(data=False)).success
    graph.until(lambda: sim.finished, 'the end of the episode')
    graph.until(lambda: len(printed) > STEPS, 'all drivers')
    recorder.stop()
    return folder


def advance(graph: Graph, sim: Any) -> None:
    """Make one step of a paused world."""
    graph.until(lambda: sim.flock_commands.complete, 'all answers')
    now = sim.now_ns
    graph.trigger('flock_sim/step')
    graph.until(lambda: sim.now_ns > now, 'a step')


@pytest.fixture(scope='module')
def episode(bag: Path) -> RecordedEpisode:
    """Return the episode as it was recorded."""
    (only,) = iter_episodes(open_bag(bag))
    return only


def test_a_bag_knows_who_drives_each_shepherd_in_each_step(
    bag: Path, episode: RecordedEpisode
) -> None:
    result = check_bag(open_bag(bag), ('scans', 'commands'))
    assert result.ok, result.text()
    assert [len(frame.drivers) for frame in episode.frames] == [2] * (STEPS + 1)
    assert {frame.drivers[0] for frame in episode.frames} == {'strombom'}
    second = [frame.drivers[1] for frame in episode.frames]
    taken = [frame.step for frame in episode.frames if frame.drivers[1] == 'keys']
    assert set(second) == {'strombom', 'keys'}
    assert taken == list(range(taken[0], taken[0] + len(taken)))
    assert abs(len(taken) - STEPS // 3) <= 1
    for frame in episode.frames:
        by_hand = np.array_equal(frame.commands[1], BY_HAND)
        assert by_hand == (frame.step in taken)


def wanted_by(bag: Path, *drivers: str) -> tuple[torch.Tensor, Report]:
    """Return the commands (n, 2) m/s of the examples with some drivers, and the report."""
    report = Report()
    found = [
        examples_of(steps, OBSERVATION, report, drivers)
        for _, steps in stream_steps([bag], report, drivers=drivers)
    ]
    return torch.cat([f.wanted for f in found if f is not None]), report


def test_examples_of_the_person_are_all_of_the_persons_steps_and_no_others(
    bag: Path, episode: RecordedEpisode, tmp_path: Path
) -> None:
    taken = sum(frame.drivers[1] == 'keys' for frame in episode.frames[:-1])
    wanted, report = wanted_by(bag, 'keys')
    assert wanted.tolist() == [list(BY_HAND)] * taken
    assert report.drops == {'another driver': 2 * STEPS - taken}
    assert report.drivers == {'keys': taken, 'strombom': 2 * STEPS - taken}
    assert f'driven:    {taken} steps by keys' in report.text()
    both, _ = wanted_by(bag, 'keys', 'strombom')
    everything, _ = wanted_by(bag)
    assert both.equal(everything)
    assert len(everything) == 2 * STEPS

    build_dataset([bag], tmp_path / 'all', OBSERVATION)
    build_dataset([bag], tmp_path / 'keys', OBSERVATION, drivers=['keys'])
    rows = parquet.read_table(tmp_path / 'all' / EPISODES_PATH).to_pylist()
    runs = [(row['shepherd'], row['driver'], row['length']) for row in rows]
    first = next(frame.step for frame in episode.frames if frame.drivers[1] == 'keys')
    assert runs == [
        (0, 'strombom', STEPS), (1, 'strombom', first), (1, 'keys', taken),
        (1, 'strombom', STEPS - first - taken),
    ]  # fmt: skip
    rows = parquet.read_table(tmp_path / 'keys' / EPISODES_PATH).to_pylist()
    assert {row['shepherd'] for row in rows} == {1}  # nobody took shepherd_0
    for name in ('all', 'keys'):
        again, _ = wanted_by(tmp_path / name, 'keys')
        assert again.equal(wanted)
    with pytest.raises(ConfigError, match='it was built with --drivers keys, expected all'):
        wanted_by(tmp_path / 'keys')


def test_cloning_learns_from_the_persons_steps_alone(
    bag: Path, episode: RecordedEpisode, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[int] = []
    add = Examples.add

    def counted(self: Examples, frames: Any, first: Any, wanted: Any, *others: Any) -> None:
        speeds = wanted.norm(dim=-1)
        assert torch.allclose(speeds, torch.tensor(BY_HAND).norm().expand(len(speeds)))
        seen.append(len(wanted))
        add(self, frames, first, wanted, *others)

    monkeypatch.setattr(Examples, 'add', counted)
    config = training.BCConfig(
        epochs=1,
        evaluation=EvaluationConfig(eval_episodes=2, eval_steps=2),
        drivers='keys',
        clone=CloneConfig(batch_size=4),
    )
    run = RunFolder(tmp_path / 'run', {'config': {'policy': POLICY, 'run': config}})
    report = training.train_bc(Policy(POLICY), [bag], config, run)
    taken = sum(frame.drivers[1] == 'keys' for frame in episode.frames[:-1])
    assert sum(seen) == report.examples == taken
    none = replace(config, drivers='joy')
    run = RunFolder(tmp_path / 'none', {'config': {'policy': POLICY, 'run': none}})
    with pytest.raises(ConfigError, match='no step of the bags can be learned from'):
        training.train_bc(Policy(POLICY), [bag], none, run)


def test_the_verb_counts_what_the_person_drove(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['dataset', 'info', str(bag), '--drivers', 'keys', '--frame-interval', '1']) == 0
    output = capsys.readouterr().out
    dropped = r'dropped:   \d+ steps, another driver; first: \S*bag\S*:0, step 0, shepherd_0'
    assert re.search(dropped, output), output
