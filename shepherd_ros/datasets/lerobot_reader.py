"""Reader of the data sets of DatasetWriter; any fault of one is a BagError."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
from pyarrow import parquet
from shepherd_ros.datasets.lerobot_format import (
    ABOUT,
    ACTION,
    DATA_PATH,
    DATASET_FORMAT,
    EPISODES_PATH,
    FILES_PER_CHUNK,
    INFO,
    LIDAR,
    NUMBERS,
)
from shepherd_ros.datasets.steps import Steps
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS, ScanLayout, sorted_channels
from shepherd_ros.sim.limits import MAX_SHEEP, MAX_SHEPHERDS, MAX_STEPS

REBUILD_HINT = 'build it again with `shepherd dataset build`'
MAX_JSON_BYTES = 16 << 20  # [bytes] of a JSON file
MAX_RUNS = 1_000_000
MAX_FILE_BYTES = 4 << 30  # [bytes] of Parquet
MAX_RAYS = 65_536
LIMITS = {  # lowest and highest number in columns of meta/episodes
    'length': (1, MAX_STEPS), 'data/chunk_index': (0, 10**6), 'data/file_index': (0, 999),
    'bag_index': (0, MAX_RUNS), 'recorded_episode': (0, 2**62),
    'n_sheep': (1, MAX_SHEEP), 'n_shepherds': (1, MAX_SHEPHERDS),
    'shepherd': (0, MAX_SHEPHERDS - 1), 'first_step': (0, MAX_STEPS),
}  # fmt: skip


def is_dataset(folder: Path) -> bool:
    """Return whether a folder has the metadata of a data set in LeRobot's form."""
    return (folder / INFO).is_file()


@dataclass(frozen=True)
class Dataset:
    """A data set on the disk; no file stays open."""

    folder: Path
    dt: float  # s
    range_max: float  # m
    layout: ScanLayout
    labels: str  # namespace of the commands
    drivers: frozenset[str]  # of its examples, all if none is named
    runs: dict[str, np.ndarray]  # columns (E,) of meta/episodes
    names: list[str]  # of the bag of each run
    driver: list[str]  # of each run, empty if not recorded
    tasks: list[str]  # of each run, what the team had to do

    @cached_property
    def files(self) -> np.ndarray:
        """Return the number of the data file of each run, (E,)."""
        return self.runs['data/chunk_index'] * FILES_PER_CHUNK + self.runs['data/file_index']

    def bags(self) -> list[tuple[str, slice]]:
        """Return name and runs of each bag in the data set."""
        return [(self.names[part.start], part) for part in _parts(self.runs['bag_index'])]

    def steps(self, part: slice) -> Iterator[Steps]:
        """Yield the episodes among some runs, one in memory at a time; raises BagError."""
        for inner in _parts(self.runs['recorded_episode'][part]):
            yield self._episode(range(part.start + inner.start, part.start + inner.stop))

    def _episode(self, chosen: range) -> Steps:
        """Return the steps of the runs of one recorded episode."""
        tables = [table for part in self._files(chosen) for table in self._read(part)]
        row = {name: int(values[chosen.start]) for name, values in self.runs.items()}
        lengths = self.runs['length'][chosen.start : chosen.stop]
        shepherd = np.repeat(self.runs['shepherd'][chosen.start : chosen.stop], lengths)
        first = self.runs['first_step'][chosen.start : chosen.stop]
        step = np.concatenate([s + np.arange(n) for s, n in zip(first, lengths, strict=True)])
        order = np.lexsort((shepherd, step))
        driver = np.repeat(np.array(self.driver[chosen.start : chosen.stop], np.str_), lengths)
        key = (step * MAX_SHEPHERDS + shepherd)[order]
        name = self.names[chosen.start]
        if (np.diff(key) <= 0).any() or shepherd.max() >= row['n_shepherds']:
            reason = f'{name}:{row["recorded_episode"]} has a step twice, or too many shepherds'
            raise BagError(self.folder / EPISODES_PATH, reason, REBUILD_HINT)
        return Steps(
            bag=name,
            episode=row['recorded_episode'],
            seed=row['seed'],
            n_sheep=row['n_sheep'],
            n_shepherds=row['n_shepherds'],
            dt=self.dt,
            range_max=self.range_max,
            step=step[order],
            shepherd=shepherd[order],
            channels=self.layout.channels,
            lidar=np.concatenate([lidar for lidar, _ in tables])[order],
            action=np.concatenate([action for _, action in tables])[order],
            driver=driver[order] if driver.any() else driver[:0],
            task=self.tasks[chosen.start],
        )

    def _files(self, chosen: range) -> Iterator[range]:
        """Yield the runs of each file among some."""
        for part in _parts(self.files[chosen.start : chosen.stop]):
            yield range(chosen.start + part.start, chosen.start + part.stop)

    def _read(self, chosen: range) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield scans (n, C, R) m and actions (n, 2) m/s of runs in one file, in row groups."""
        number = self.files[chosen.start]
        chunk, file = divmod(int(number), FILES_PER_CHUNK)
        path = self.folder / DATA_PATH.format(chunk_index=chunk, file_index=file)
        begin = int(np.searchsorted(self.files, number))
        with _open(path) as source:
            for k in chosen:
                yield self._run(source, path, k, k - begin)

    def _run(self, source: Any, path: Path, k: int, place: int) -> tuple[np.ndarray, np.ndarray]:
        """Return scans and actions of a run, which is a row group."""
        count = int(self.runs['length'][k])
        names = [LIDAR, ACTION, 'episode_index', 'frame_index']
        table = source.read_row_group(place, names, use_threads=False)
        lidar = _array(table[LIDAR], pa.float32(), (count, *self.layout.shape))
        action = _array(table[ACTION], pa.float32(), (count, 2))
        numbers = [_array(table[name], pa.int64(), (count,)) for name in names[2:]]
        if np.isnan(lidar).any() or not np.isfinite(action).all():
            reason = f'row group {place} has NaN, or an action that is not finite'
            raise BagError(path, reason, REBUILD_HINT)
        if (numbers[0] != k).any() or not np.array_equal(numbers[1], np.arange(count)):
            raise BagError(path, f'row group {place} is not that of episode {k}', REBUILD_HINT)
        return lidar, action


def open_dataset(folder: Path) -> Dataset:
    """Return the data set in a folder; raises BagError."""
    meta = _read_meta(folder)
    path = folder / EPISODES_PATH
    with _open(path) as source:
        if source.metadata.num_rows > MAX_RUNS:
            raise BagError(path, f'it has more than {MAX_RUNS} rows', REBUILD_HINT)
        drivers = [name for name in source.schema_arrow.names if name == 'driver']
        table = source.read([*NUMBERS, 'bag', 'tasks', *drivers], use_threads=False)
        count = np.arange(len(table))
        runs = {name: _array(table[name], pa.int64(), count.shape) for name in NUMBERS}
        bags = [str(name) for name in table['bag'].to_pylist()]
        tasks = [', '.join(texts or []) for texts in table['tasks'].to_pylist()]
        driver = table['driver'].to_pylist() if drivers else [''] * len(table)
    for name, (low, high) in LIMITS.items():
        invalid = (runs[name] < low) | (runs[name] > high)
        if invalid.any():
            value = runs[name][invalid][0]
            raise BagError(path, f'{name} is {value}, expected {low} to {high}', REBUILD_HINT)
    ends = np.cumsum(runs['length'])
    lidar = meta['range_max'], meta['layout']
    learned, driver = (meta['labels'], meta['drivers']), [str(name or '') for name in driver]
    dataset = Dataset(folder, meta['dt'], *lidar, *learned, runs, bags, driver, tasks)
    if not (
        (np.diff(dataset.files) >= 0).all()
        and np.array_equal(runs['episode_index'], count)
        and np.array_equal(runs['dataset_to_index'], ends)
        and np.array_equal(runs['dataset_from_index'], ends - runs['length'])
    ):
        raise BagError(path, 'its episodes are not in order, or some are missing', REBUILD_HINT)
    return dataset


def _read_meta(folder: Path) -> dict[str, Any]:
    """Return the content of meta/shepherd_ros.json, with the layout; raises BagError."""
    path = folder / ABOUT
    if not path.is_file():
        raise BagError(folder, f'{ABOUT} is not there, so it is no data set of ours', REBUILD_HINT)
    try:
        with path.open('rb') as file:
            meta = json.loads(file.read(MAX_JSON_BYTES).decode())
    except (OSError, ValueError, RecursionError) as error:
        raise BagError(path, f'it cannot be read ({error!r:.200})', REBUILD_HINT) from error
    if not isinstance(meta, dict) or meta.get('format') != DATASET_FORMAT:
        raise BagError(path, f'it does not begin with format {DATASET_FORMAT!r}', REBUILD_HINT)
    dt, rays, labels = (meta.get(name) for name in ('dt', 'n_rays', 'labels'))
    if not (isinstance(dt, float) and 0 <= dt <= 10 and isinstance(labels, str)):
        raise BagError(path, f'dt is {dt!r:.40} s and labels {labels!r:.40}', REBUILD_HINT)
    range_max = meta.setdefault('range_max', 0.0)
    if not (isinstance(range_max, float) and 0 <= range_max <= 1e6):
        raise BagError(path, f'range_max is {range_max!r:.40} m', REBUILD_HINT)
    if not (isinstance(rays, int) and 0 <= rays <= MAX_RAYS):
        raise BagError(path, f'n_rays is {rays!r:.40}, expected 0 to {MAX_RAYS}', REBUILD_HINT)
    channels = meta.get('channels', list(PAPER_CHANNELS))
    valid = isinstance(channels, list) and all(isinstance(name, str) for name in channels)
    if not valid or channels != list(sorted_channels(channels)):
        raise BagError(
            path, f'channels are {channels!r:.80}, expected names in order', REBUILD_HINT
        )
    drivers = meta.get('drivers', [])
    if not (isinstance(drivers, list) and all(isinstance(name, str) for name in drivers)):
        raise BagError(path, f'drivers are {drivers!r:.80}, expected names', REBUILD_HINT)
    layout = ScanLayout(tuple(channels), rays)
    return meta | {'layout': layout, 'drivers': frozenset(drivers)}


@contextmanager
def _open(path: Path) -> Iterator[Any]:
    """Yield an open Parquet file; any error of Arrow becomes a BagError."""
    if not path.is_file():
        raise BagError(path, 'it is not there', REBUILD_HINT)
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise BagError(path, f'it has more than {MAX_FILE_BYTES} bytes', REBUILD_HINT)
        with parquet.ParquetFile(
            path,
            pre_buffer=False,
            page_checksum_verification=True,
            thrift_string_size_limit=1 << 20,
            thrift_container_size_limit=1 << 20,
        ) as source:
            yield source
    except BagError:
        raise
    except (pa.ArrowException, LookupError, OSError, TypeError, ValueError) as error:
        raise BagError(path, f'it cannot be read ({str(error)[:200]!r})', REBUILD_HINT) from error


def _array(column: Any, kind: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return a column of nested lists as an array; pyarrow raises where the shape differs."""
    for size in reversed(shape[1:]):
        kind = pa.list_(kind, size)
    values = column.combine_chunks().cast(kind)
    for _ in shape[1:]:
        values = values.flatten()
    return values.to_numpy().reshape(shape)


def _parts(values: np.ndarray) -> Iterator[slice]:
    """Yield the slices in which values (E,) are equal."""
    edges = np.nonzero(np.diff(values))[0] + 1
    for a, b in pairwise([0, *edges.tolist(), len(values)]):
        if b > a:
            yield slice(a, b)
