"""Whatever is done to checkpoints, bags and data sets: they open, or ConfigError says why not."""

from __future__ import annotations

from collections.abc import Iterator
import json
import os
from pathlib import Path
import subprocess
import sys
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
CASES = (('checkpoint:2000',), ('built:1000', 'bag:1000'))
SMALL = PolicyConfig(
    lidar=LidarConfig(n_rays=64), network=NetworkConfig(filters_1=2, filters_2=3, hidden=4)
)


@pytest.fixture
def folder() -> Iterator[Path]:
    """Lend a folder in memory, where there is one: thousands of files are written."""
    with tempfile.TemporaryDirectory(dir=MEMORY if os.access(MEMORY, os.W_OK) else None) as name:
        yield Path(name)


def test_damaged_and_hostile_files_end_in_words(folder: Path) -> None:
    seeds = folder / 'seeds'
    (seeds / 'bags').mkdir(parents=True)
    for kind in ('none', 'zstd', 'lz4'):
        tiny_bag(seeds / 'bags' / kind, compression=kind, chunk_size=6000)
    build_dataset([seeds / 'bags' / 'none'], seeds / 'built', ObservationConfig())
    save_policy(seeds / 'small.safetensors', Policy(SMALL), {'command': 'none', 'score': 1.5})
    environment = os.environ | {'OMP_NUM_THREADS': '1', 'PYTHONPATH': str(FUZZ.parents[1])}
    running = []
    for k, cases in enumerate(CASES):  # at the same time
        (folder / f'work{k}').mkdir()
        command = [sys.executable, str(FUZZ), str(seeds), str(folder / f'work{k}'), *cases]
        running.append(
            subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
            )
        )
    ends: dict[str, int] = {}
    for process in running:
        out, errors = process.communicate()
        assert process.returncode == 0, errors[-3000:]
        result = json.loads(out.splitlines()[-1])
        assert result['bad'] == []
        assert result['more'] < 150  # MiB
        ends |= result['ends']
    assert sum(ends.values()) == 4000
    kinds = ('checkpoint', 'built', 'bag')
    assert all(ends[f'{kind} {end}'] > 30 for kind in kinds for end in ('opened', 'refused'))
