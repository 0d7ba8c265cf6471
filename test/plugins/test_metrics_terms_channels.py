"""A metric, a term of the reward and a channel of a lidar, each from one file, everywhere."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import json
import os
from pathlib import Path
import subprocess

from nodes.process import DEADLINE, Graph
from plugins.verbs import run
import pyarrow.parquet as parquet
import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.policy.checkpoint import read_checkpoint_metadata
from shepherd_ros.recordings.check import check_bag
from shepherd_ros.recordings.episodes import iter_episodes
from shepherd_ros.recordings.info import bag_info
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS
from shepherd_ros.sim.reward import RewardConfig
from std_srvs.srv import SetBool

FOLDER = Path(__file__).parent
FILES = ','.join(str(FOLDER / name) for name in ('near.py', 'path.py', 'posts.py'))
STEPS = 12
pytestmark = [
    pytest.mark.system,
    pytest.mark.xdist_group('plugins'),  # one training and one bag for all
]
ENVIRONMENT = """
from dataclasses import replace
from shepherd_ros.registry import load_plugins
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.presets import world_preset
from shepherd_ros.sim.reward import RewardConfig
from shepherd_ros.sim.rollout import EnvConfig
import torch

load_plugins()
import near, posts

world = replace(world_preset(), n_sheep=5, n_shepherds=2, episode_steps=6)
lidar = LidarConfig(n_rays=64, others='posts', cross_occlusion=False)
reward = RewardConfig.from_dict({'path': 0.5})
config = EnvConfig(world=world, lidar=lidar, reward=reward)
assert EnvConfig.from_dict(config.to_dict()) == config
assert EnvConfig.from_dict(config.changes()) == config
env = ShepherdEnv(config, 3)
seen, _ = env.reset(1)
assert seen.shape == (3, 2, 3, 4, 64)
largest = near.share_near(env.state)
for step in range(13):  # more than two episodes
    before = env.state
    seen, total, _, ended, info = env.step(torch.ones(3, 2, 2) * (step - 3))
    after = info.get('final_state', env.state)
    terms = info['reward_terms']
    moved = (after.shepherds - before.shepherds).norm(dim=-1) * after.shepherd_mask
    cost = -0.5 * moved.sum(dim=-1) / after.team_size / 6
    torch.testing.assert_close(terms['path'], cost)
    torch.testing.assert_close(total, sum(terms.values()))
    assert list(terms) == ['occupancy', 'shaping', 'path']
    largest = torch.maximum(largest, near.share_near(after))
    got = info.get('final_metrics', env.metrics())
    assert torch.equal(got['fraction_near'], near.share_near(after))
    assert torch.equal(got['most_near'], largest)
    if ended.any():
        largest = near.share_near(env.state)
        assert torch.equal(env.metrics()['most_near'], largest)
there = env.state.shepherds[:, :1]
centers = torch.tensor(posts.PLACES)
gap = (there - centers).norm(dim=-1) - posts.RADIUS  # to the nearest post
nearest = seen[:, 0, -1, 3].amin(dim=-1)
inside = gap.amin(dim=-1) <= 0
assert ((nearest - gap.amin(dim=-1)).abs()[~inside] < 0.2).all()
"""


@contextmanager
def named() -> Iterator[None]:
    """Name the plug-ins to processes that are started; this one does without."""
    os.environ['SHEPHERD_ROS_PLUGINS'] = FILES
    try:
        yield
    finally:
        del os.environ['SHEPHERD_ROS_PLUGINS']


@pytest.fixture(scope='module')
def trained(commands: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """Return a tiny run of PPO with all of them, and what verbs say of its checkpoint."""
    out = tmp_path_factory.mktemp('ppo') / 'run'
    best = out / 'best.safetensors'
    output = run(
        commands / 'python',
        FILES,
        f'train ppo --quick --out {out} --path 0.5 --samples 150 --policy.lidar.others posts '
        '--groups 1 --worlds 4 --decisions 4 --eval-episodes 2 --eval-steps 20',
        f'checkpoint info {best} --json',
        f'checkpoint card {best}',
        'evaluate table --quick --sheep 5 --shepherds 1 --controllers strombom '
        f'policy:{best} --out {out / "rows"}',
    )
    return out, output[1:]


def test_in_the_environment(commands: Path, tmp_path: Path) -> None:
    environment = os.environ | {'SHEPHERD_ROS_PLUGINS': FILES}
    (tmp_path / 'steps.py').write_text(ENVIRONMENT)
    command = [commands / 'python', tmp_path / 'steps.py']
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_in_training(trained: tuple[Path, list[str]]) -> None:
    out, (about, card, _) = trained
    lines = [json.loads(line) for line in (out / 'curve.jsonl').read_text().splitlines()]
    for line in lines:
        terms = {name: value for name, value in line.items() if name.startswith('reward/')}
        assert list(terms) == ['reward/occupancy', 'reward/shaping', 'reward/path']
        assert sum(terms.values()) == pytest.approx(line['reward'], abs=1e-7)
        assert terms['reward/path'] < 0
    assert 0 <= lines[-1]['eval/fraction_near'] <= 1
    assert 'eval/most_near' not in lines[-1]
    reward = json.loads((out / 'run.json').read_text())['config']['run']['task']['reward']
    assert reward['path'] == 0.5
    assert '"others": "posts"' in about
    with pytest.raises(ConfigError, match="others is 'posts'"):
        read_checkpoint_metadata(out / 'best.safetensors')  # not without the plug-in
    assert 'channels sheep, shepherds, goal, posts,' in card
    assert '| reward.path | 0.5 |' in card
    assert '| fraction near | ' in card


def test_what_a_run_without_a_weight_says_is_as_before() -> None:
    assert list(RewardConfig().to_dict()) == ['occupancy', 'shaping', 'one_per_step']
    assert 'others' not in LidarConfig().to_dict()
    with pytest.raises(ConfigError, match='path'):
        RewardConfig.from_dict({'path': 0.5})  # not without its plug-in
    with pytest.raises(ConfigError, match="others is 'posts'"):
        LidarConfig(others='posts')


def test_in_rows_and_tables(trained: tuple[Path, list[str]]) -> None:
    rows = trained[0] / 'rows'
    names = [set(parquet.read_schema(path).names) for path in rows.rglob('*.parquet')]
    assert names
    assert all({'fraction_near', 'most_near'} <= columns for columns in names)
    page = (rows / 'table.md').read_text()
    assert '| fraction near |' in page
    assert 'most near' not in page


@pytest.fixture(scope='module')
def recorded(
    shared_graph: Graph,
    tmp_path_factory: pytest.TempPathFactory,
    trained: tuple[Path, list[str]],
) -> Path:
    """Return a bag of a stack in which lidar, policy, metrics and recorder have the plug-ins."""
    graph, bag = shared_graph, tmp_path_factory.mktemp('bag') / 'bag'
    with named():
        recorder = graph.start_words('recorder', ['-v', '-o', str(bag)])
        graph.until_says(recorder, 'listening')
        flock = graph.start('flock_sim', n_sheep=5, n_shepherds=2, episode_steps=STEPS, episodes=1)
        assert graph.call('/flock_sim/pause', SetBool, SetBool.Request(data=True)).success
        rays = {'n_rays': 512, 'others': 'posts'}
        graph.start('lidar', shepherd_ids=[0, 1], **rays)
        graph.start('metrics')
        checkpoint = str(trained[0] / 'best.safetensors')
        graph.start('policy', shepherd_ids=[0, 1], checkpoint=checkpoint)
    late = [f'/shepherd_{i}/{topic}' for i in (0, 1) for topic in ('scan/posts', 'cmd_vel')]
    for topic in ('/metrics/most_near', *late):
        graph.until_says(recorder, f'recording {topic} ')
    track = graph.track()
    graph.until(lambda: len(track.shown) > 2, 'a paused world shows its state')
    assert graph.call('/flock_sim/pause', SetBool, SetBool.Request(data=False)).success
    graph.until(lambda: flock.code is not None, 'the episode ends', 2 * DEADLINE)
    graph.idle(1.0)
    recorder.stop()
    return bag


def test_over_dds_and_in_bags(recorded: Path) -> None:
    bag = open_bag(recorded)
    assert bag.topics['/metrics/most_near'].count > STEPS
    assert bag.topics['/shepherd_1/scan/posts'].count > STEPS
    found = check_bag(bag, ('scans', 'commands'))  # without the plug-ins, by their families
    assert found.ok, found.text()
    (episode,) = iter_episodes(bag)
    assert episode.channels == (*PAPER_CHANNELS, 'posts')
    assert all(scan is not None and scan.shape == (4, 512) for scan in episode.frames[0].scans)
    assert 'fraction near' not in bag_info(bag).text()  # not without its plug-in


def test_verbs_read_the_bag_and_learning_needs_the_channels_of_the_policy(
    recorded: Path, commands: Path, tmp_path: Path
) -> None:
    few = '--quick --epochs 1 --eval-episodes 2 --eval-steps 10'
    posts = '--policy.lidar.others posts'
    built = tmp_path / 'built'
    info, _, _, refused, *_ = run(
        commands / 'python',
        FILES,
        f'bag info {recorded}',
        f'bag export {recorded} --output {tmp_path / "tables"}',
        f'bag render {recorded} --output {tmp_path / "pictures"}',
        f'!train bc {recorded} {few} --out {tmp_path / "three"}',
        f'train bc {recorded} {few} {posts} --out {tmp_path / "four"}',
        f'dataset build {recorded} --out {built}',
        f'train bc {built} {few} {posts} --out {tmp_path / "again"}',
    )
    assert 'fraction near' in info
    assert 'posts' in parquet.read_schema(tmp_path / 'tables' / 'scans.parquet').names
    assert "scans have a channel 'posts', expected sheep, shepherds, goal" in refused
    features = json.loads((built / 'meta/info.json').read_text())['features']
    assert features['observation.lidar']['shape'] == [4, 512]


def test_a_policy_names_the_channel_that_no_lidar_has(
    graph: Graph, trained: tuple[Path, list[str]]
) -> None:
    with named():
        checkpoint = str(trained[0] / 'best.safetensors')
        policy = graph.start('policy', checkpoint=checkpoint)
    graph.start('lidar')
    graph.start('flock_sim', n_sheep=5, n_shepherds=1)
    graph.until_says(policy, 'no lidar publishes shepherd_0/scan/posts')
    status = graph.until(lambda: graph.status('policy: policy'), 'its status')
    graph.until(
        lambda: 'shepherd_0/scan/posts' in graph.status('policy: policy').message,
        lambda: f'a refusal; it last said {status}',
    )
