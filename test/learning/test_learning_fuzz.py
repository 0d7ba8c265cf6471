"""Whatever is done to checkpoints, bags and data sets: they open, or ConfigError says why not."""

from __future__ import annotations

from collections.abc import Iterator
import json
import os
from pathlib import Path
import subprocess
import tempfile

import pytest
from rosbag2.tiny import tiny_bag
from shepherd_ros.datasets.examples import build_dataset
from shepherd_ros.policy.checkpoint import save_policy
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import ObservationConfig

FUZZ = Path(__file__).with_name('learning_fuzz.py')
MEMORY = Path('/dev/shm')
CASES = {'checkpoint': 1000, 'built': 500, 'bag': 500}
SMALL = PolicyConfig(
    lidar=LidarConfig(n_rays=64), network=NetworkConfig(filters_1=2, filters_2=3, hidden=4)
)


@pytest.fixture
def folder() -> Iterator[Path]:
    """Lend a folder in memory, where there is one: thousands of files are written."""
    with tempfile.TemporaryDirectory(dir=MEMORY if os.access(MEMORY, os.W_OK) else None) as name:
        yield Path(name)


@pytest.mark.system
def test_damaged_and_hostile_files_end_in_words(folder: Path, commands: Path) -> None:
    seeds = folder / 'seeds'
    (seeds / 'bags').mkdir(parents=True)
    for kind in ('none', 'zstd', 'lz4'):
        tiny_bag(seeds / 'bags' / kind, compression=kind, chunk_size=6000)
    build_dataset([seeds / 'bags' / 'none'], seeds / 'built', ObservationConfig())
    save_policy(seeds / 'small.safetensors', Policy(SMALL), {'command': 'none', 'score': 1.5})
    environment = os.environ | {'OMP_NUM_THREADS': '1', 'PYTHONPATH': str(FUZZ.parents[1])}
    (folder / 'work').mkdir()
    cases = [f'{kind}:{count}' for kind, count in CASES.items()]
    done = subprocess.run(
        [commands / 'python', FUZZ, seeds, folder / 'work', *cases],
        capture_output=True, text=True, env=environment,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    result = json.loads(done.stdout.splitlines()[-1])
    assert result['bad'] == []
    assert result['more'] < 150  # MiB
    ends = result['ends']
    assert sum(ends.values()) == sum(CASES.values())
    assert all(ends[f'{kind} {end}'] > 15 for kind in CASES for end in ('opened', 'refused'))
