"""A metric, a term of the reward and a channel of a lidar, each from one file, everywhere."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import json
import os
from pathlib import Path
import subprocess
import sys

from nodes.process import DEADLINE, Graph
import pyarrow.parquet as parquet
import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.policy.checkpoint import read_checkpoint_metadata
from shepherd_ros.recordings.check import check_bag
from shepherd_ros.recordings.episodes import iter_episodes
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS
from shepherd_ros.sim.metrics import METRICS
from shepherd_ros.sim.reward import RewardConfig

FOLDER = Path(__file__).parent
FILES = ','.join(str(FOLDER / name) for name in ('near.py', 'path.py', 'posts.py'))
SHEPHERD = Path(sys.executable).with_name('shepherd')
STEPS = 12
pytestmark = pytest.mark.xdist_group('plugins')  # one training and one bag for all
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


def run(*words: str | Path, code: int = 0, plug: bool = True) -> str:
    """Run a program with the plug-ins; return what it said."""
    environment = os.environ | {'SHEPHERD_ROS_PLUGINS': FILES if plug else ''}
    done = subprocess.run(
        [str(word) for word in words], env=environment, capture_output=True, text=True
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope='module')
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a tiny run of PPO with all of them."""
    out = tmp_path_factory.mktemp('ppo') / 'run'
    run(
        SHEPHERD, 'train', 'ppo', '--quick', '--out', out, '--path', '0.5', '--samples', '150',
        '--policy.lidar.others', 'posts', '--groups', '1', '--worlds', '4', '--decisions', '4',
        '--eval-episodes', '2', '--eval-steps', '20',
    )  # fmt: skip
    return out


def test_in_the_environment() -> None:
    run(sys.executable, '-c', ENVIRONMENT)


def test_in_training(trained: Path) -> None:
    lines = [json.loads(line) for line in (trained / 'curve.jsonl').read_text().splitlines()]
    for line in lines:
        terms = {name: value for name, value in line.items() if name.startswith('reward/')}
        assert list(terms) == ['reward/occupancy', 'reward/shaping', 'reward/path']
        assert sum(terms.values()) == pytest.approx(line['reward'], abs=1e-7)
        assert terms['reward/path'] < 0
    assert 0 <= lines[-1]['eval/fraction_near'] <= 1
    assert 'eval/most_near' not in lines[-1]
    about = json.loads((trained / 'run.json').read_text())['config']['run']['task']['reward']
    assert about['path'] == 0.5
    said = run(SHEPHERD, 'checkpoint', 'info', trained / 'best.safetensors')
    assert '"others": "posts"' in said
    with pytest.raises(ConfigError, match="others is 'posts'"):
        read_checkpoint_metadata(trained / 'best.safetensors')  # not without the plug-in
    card = run(SHEPHERD, 'checkpoint', 'card', trained / 'best.safetensors')
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


def test_in_rows_and_tables(trained: Path, tmp_path: Path) -> None:
    policy = f'policy:{trained / "best.safetensors"}'
    run(
        SHEPHERD, 'evaluate', 'table', '--quick', '--sheep', '5', '--shepherds', '1',
        '--controllers', 'strombom', policy, '--out', tmp_path,
    )  # fmt: skip
    names = [set(parquet.read_schema(path).names) for path in tmp_path.rglob('*.parquet')]
    assert names
    assert all({'fraction_near', 'most_near'} <= columns for columns in names)
    page = (tmp_path / 'table.md').read_text()
    assert '| fraction near |' in page
    assert 'most near' not in page


@pytest.fixture(scope='module')
def recorded(shared_graph: Graph, tmp_path_factory: pytest.TempPathFactory, trained: Path) -> Path:
    """Return a bag of a whole stack with the plug-ins, driven by the policy."""
    return record(shared_graph, tmp_path_factory.mktemp('bag') / 'bag', trained)


def record(graph: Graph, bag: Path, trained: Path) -> Path:
    """Record an episode; lidar, policy, metrics and recorder have the plug-ins."""
    with named():
        recorder = graph.start_words('recorder', ['-o', str(bag)], fresh=True)
        graph.until_says(recorder, 'listening')
        rays = {'n_rays': 512, 'others': 'posts'}
        graph.start('lidar', fresh=True, shepherd_ids=[0, 1], **rays)
        graph.start('metrics', fresh=True)
        checkpoint = str(trained / 'best.safetensors')
        graph.start('policy', fresh=True, shepherd_ids=[0, 1], checkpoint=checkpoint)
    graph.until_says(recorder, 'recording /metrics/most_near ')
    graph.until_says(recorder, 'recording /shepherd_1/scan/posts ')
    flock = graph.start('flock_sim', n_sheep=5, n_shepherds=2, episode_steps=STEPS, episodes=1)
    graph.until(lambda: flock.code is not None, 'the episode ends', 2 * DEADLINE)
    graph.idle(1.0)
    recorder.stop()
    return bag


def test_over_dds_and_in_bags(recorded: Path, tmp_path: Path) -> None:
    bag = open_bag(recorded)
    assert bag.topics['/metrics/most_near'].count > STEPS
    assert bag.topics['/shepherd_1/scan/posts'].count > STEPS
    found = check_bag(bag, ('scans', 'commands'))  # without the plug-ins, by their families
    assert found.ok, found.text()
    (episode,) = iter_episodes(bag)
    assert episode.channels == (*PAPER_CHANNELS, 'posts')
    assert all(scan is not None and scan.shape == (4, 512) for scan in episode.frames[0].scans)
    said = run(SHEPHERD, 'bag', 'info', recorded)
    assert 'fraction near' in said
    assert 'fraction near' not in run(SHEPHERD, 'bag', 'info', recorded, plug=False)
    run(SHEPHERD, 'bag', 'export', recorded, '--output', tmp_path / 'tables')
    assert 'posts' in parquet.read_schema(tmp_path / 'tables' / 'scans.parquet').names
    run(SHEPHERD, 'bag', 'render', recorded, '--output', tmp_path / 'pictures')


def test_learning_from_bags_needs_the_channels_of_the_policy(
    recorded: Path, tmp_path: Path
) -> None:
    words = (SHEPHERD, 'train', 'bc', recorded, '--quick', '--epochs', '1')
    few = ('--eval-episodes', '2', '--eval-steps', '10')
    said = run(*words, *few, '--out', tmp_path / 'three', code=2)
    assert "scans have a channel 'posts', expected sheep, shepherds, goal" in said
    posts = ('--policy.lidar.others', 'posts')
    run(*words, *few, *posts, '--out', tmp_path / 'four')
    built = tmp_path / 'built'
    run(SHEPHERD, 'dataset', 'build', recorded, '--out', built)
    assert json.loads((built / 'meta/info.json').read_text())['features']['observation.lidar'][
        'shape'
    ] == [4, 512]
    run(*words[:3], built, *words[4:], *few, *posts, '--out', tmp_path / 'again')


def test_a_policy_names_the_channel_that_no_lidar_has(graph: Graph, trained: Path) -> None:
    with named():
        checkpoint = str(trained / 'best.safetensors')
        policy = graph.start('policy', fresh=True, checkpoint=checkpoint)
    graph.start('lidar')
    graph.start('flock_sim', n_sheep=5, n_shepherds=1)
    graph.until_says(policy, 'no lidar publishes shepherd_0/scan/posts')
    status = graph.until(lambda: graph.status('policy: policy'), 'its status')
    graph.until(
        lambda: 'shepherd_0/scan/posts' in graph.status('policy: policy').message,
        lambda: f'a refusal; it last said {status}',
    )


def test_metrics_of_the_demo(tmp_path: Path) -> None:
    said = run(
        SHEPHERD, 'demo', '--controller', 'strombom', '--sheep', '5', '--shepherds', '1',
        '--steps', '10', '--animation', 'none', '--out', tmp_path,
    )  # fmt: skip
    assert 'fraction_near' in said
    assert 'fraction_near' not in METRICS  # this process has no plug-in
