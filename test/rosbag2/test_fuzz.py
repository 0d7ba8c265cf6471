"""Whatever is done to a bag, reading it ends: with its content or with BagError."""

from __future__ import annotations

from collections.abc import Iterator
import json
import os
from pathlib import Path
import random
import subprocess
import sys
import tempfile

from mcap.writer import CompressionType
import pytest
from rosbag2.test_reader import mcap_of_others
from rosbag2.tiny import recording, Sent, tiny_bag, write
from shepherd_ros.recordings.check import check_bag
from shepherd_ros.recordings.episodes import iter_episodes
from shepherd_ros.recordings.info import bag_info
from shepherd_ros.rosbag2.bag_files import write_atomically
from shepherd_ros.rosbag2.diff import diff_bags
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.rosbag2.metadata import FileInfo, Metadata
from shepherd_ros.rosbag2.reader import open_bag

MESSAGES = list(recording()[0])
CASES = 500
FUZZ = Path(__file__).with_name('fuzz.py')
MEMORY = Path('/dev/shm')


@pytest.fixture(scope='module')
def place() -> Iterator[Path]:
    """Lend a folder in memory, where there is one: thousands of bags are written."""
    with tempfile.TemporaryDirectory(dir=MEMORY if os.access(MEMORY, os.W_OK) else None) as name:
        yield Path(name)


@pytest.fixture(scope='module')
def seeds(place: Path) -> Path:
    """Return a folder of whole bags: ours in every packing, and those of others without CRC."""
    folder = place / 'seeds'
    folder.mkdir()
    for kind in ('none', 'zstd', 'lz4'):
        tiny_bag(folder / kind, compression=kind, chunk_size=6000)
    tiny_bag(folder / 'split', split_bytes=9000)
    for name, options in (
        ('chunks', {'compression': CompressionType.NONE, 'chunk_size': 6000}),
        ('packed', {'compression': CompressionType.ZSTD, 'chunk_size': 6000}),
        ('plain', {'use_chunking': False}),
        ('bare', {'use_chunking': False, 'use_statistics': False, 'repeat_channels': False}),
    ):
        (folder / name).mkdir()
        path = folder / name / f'{name}_0.mcap'
        mcap_of_others(path, MESSAGES, enable_crcs=False, **options)
        metadata = Metadata(files=(FileInfo(path.name),))
        write_atomically(folder / name / 'metadata.yaml', metadata.document())
    return folder


@pytest.mark.system
def test_damaged_files_end_in_words(place: Path, seeds: Path) -> None:
    work = place / 'work'
    work.mkdir()
    command = [sys.executable, str(FUZZ), str(seeds), str(work), '0', str(CASES)]
    environment = os.environ | {'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr[-3000:]
    result = json.loads(done.stdout.splitlines()[-1])
    assert result['bad'] == []
    assert sum(result['ends'].values()) == CASES
    assert min(result['ends'].get(end, 0) for end in ('refused', 'broken', 'unharmed')) > 12
    assert result['peak'] < 150  # MiB


def test_damaged_messages_in_a_whole_file_end_in_words(place: Path) -> None:
    """Bytes of messages are changed before they are written, so that no checksum tells."""
    for seed in range(100):
        rng = random.Random(seed)
        rows: list[Sent] = []
        for message in MESSAGES[: rng.randrange(len(MESSAGES))]:
            data = bytearray(message.data)
            if rng.random() < 0.03:
                del data[rng.randrange(len(data)) :]
            if rng.random() < 0.03 and data:
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            stamp = message.log_ns + rng.choice([0, 0, 0, 10**6, -(10**6), 10**15])
            if rng.random() > 0.01:
                rows.append(message._replace(data=bytes(data), log_ns=stamp))
        bag = open_bag(write(place / f'm{seed}', rows, chunk_size=4000))
        check_bag(bag)
        for action in (bag_info, lambda b: list(iter_episodes(b)), lambda b: diff_bags(b, b)):
            try:
                action(bag)  # type: ignore[operator]
            except BagError as error:
                assert str(error).startswith(str(bag.path))
