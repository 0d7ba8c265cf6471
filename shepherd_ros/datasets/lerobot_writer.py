"""
Writer of complete steps as a data set in Parquet, with the folders and columns of LeRobot 3.0.

A row is a step of one shepherd, a LeRobot episode a run of its steps with one driver and no hole.
Values without a place in LeRobot are in further columns of meta/episodes and shepherd_ros.json.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
import json
import math
from pathlib import Path
import shutil
from types import TracebackType
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
from pyarrow import parquet
from shepherd_ros import __version__
from shepherd_ros.datasets.lerobot_format import (
    ABOUT,
    ACTION,
    DATA_PATH,
    DATASET_FORMAT,
    EPISODE_SCHEMA,
    EPISODES_PATH,
    features,
    FILE_SIZE,
    FILES_PER_CHUNK,
    INDEXED_BY_TASK,
    INFO,
    LIDAR,
    NUMBERS,
    STATS,
    STEP_SCHEMA,
    TASK_TABLE,
)
from shepherd_ros.datasets.running_stats import RunningStats
from shepherd_ros.datasets.steps import Steps
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS, ScanLayout


class DatasetWriter:
    """A data set that is being written; it gets its name when it is complete."""

    def __init__(
        self,
        folder: Path,
        labels: str = '',
        file_size: int = FILE_SIZE << 20,
        drivers: Collection[str] = (),
    ) -> None:
        """
        Create the folder; raises BagError if it exists.

        labels is the namespace of the commands, file_size [bytes] the size of a full file; drivers
        are those of the examples, all if none is named.
        """
        if folder.exists():
            raise BagError(folder, 'it exists already', 'choose another folder or remove this one')
        self.folder, self.labels, self.file_size = folder, labels, file_size
        self.drivers = sorted(drivers)
        self.part = folder.with_name(f'.{folder.name}.part')
        self.dt, self.range_max, self.layout = 0.0, 0.0, ScanLayout(PAPER_CHANNELS, 0)
        self.rows, self.runs, self.files, self.bags = 0, 0, 0, 0
        self.tasks: dict[str, int] = {}  # index by text, in the order of their first runs
        self._bag = ''
        self._in_file = 0  # [bytes]
        self._data: Any = None
        self._pending: list[dict[str, Any]] = []  # of meta/episodes, not written yet
        self._ranges, self._actions = RunningStats(len(PAPER_CHANNELS)), RunningStats(2)
        try:
            shutil.rmtree(self.part, ignore_errors=True)
            (self.part / EPISODES_PATH).parent.mkdir(parents=True)
            self._episodes = parquet.ParquetWriter(
                self.part / EPISODES_PATH, EPISODE_SCHEMA, compression='zstd'
            )
        except OSError as error:
            raise self._unwritable(error) from error

    def __enter__(self) -> DatasetWriter:
        """Return the writer."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Remove an unfinished data set."""
        if self.part.exists():
            for writer in (self._data, self._episodes):
                if writer is not None:
                    writer.close()
            shutil.rmtree(self.part, ignore_errors=True)

    def begin_bag(self, name: str) -> None:
        """Begin the steps of a bag."""
        self._bag, self.bags = name, self.bags + 1

    def add(self, steps: Steps) -> None:
        """Write the steps of an episode; raises BagError."""
        if not len(steps):
            return
        if not self.rows:
            self.dt, self.range_max, self.layout = steps.dt, steps.range_max, steps.layout
            self._ranges = RunningStats(len(steps.channels))
        if (steps.dt, steps.range_max, steps.layout) != (self.dt, self.range_max, self.layout):
            raise BagError(
                steps.where,
                f'range_max is {steps.range_max} m, dt is {steps.dt} s and a scan has '
                f'{steps.layout.n_rays} rays, expected {self.dt} s and {self.layout.n_rays} as in '
                f'the bags before, and {self.range_max} m',
                'build a data set of each kind',
            )
        self.tasks.setdefault(steps.task, len(self.tasks))
        self._ranges.add(steps.lidar.swapaxes(1, 2).reshape(-1, len(steps.channels)))
        self._actions.add(steps.action)
        try:
            for chosen in runs(steps):
                self._add_run(steps, chosen)
            if len(self._pending) >= FILES_PER_CHUNK:
                self._flush()
        except OSError as error:
            raise self._unwritable(error) from error

    def close(self, report: Mapping[str, Any]) -> None:
        """Finish all files and rename the folder; raises BagError."""
        try:
            self._flush()
            self._episodes.close()
            self._end_file()
            self._write_meta(report)
            self.part.rename(self.folder)
        except OSError as error:
            raise self._unwritable(error) from error

    def _add_run(self, steps: Steps, chosen: np.ndarray) -> None:
        """Write a run of steps as an episode of LeRobot, which is a row group."""
        size = len(chosen) * (math.prod(self.layout.shape) + 2) * 4
        if self._data is not None and self._in_file + size > self.file_size:
            self._end_file()
        chunk, file = divmod(self.files, FILES_PER_CHUNK)
        if self._data is None:
            path = self.part / DATA_PATH.format(chunk_index=chunk, file_index=file)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._data = parquet.ParquetWriter(
                path,
                STEP_SCHEMA,
                compression='zstd',
                use_dictionary=False,
                write_page_checksum=True,
            )
            self._in_file = 0
        self._data.write_table(self._table(steps, chosen), row_group_size=len(chosen))
        self._in_file += size
        count, first = len(chosen), chosen[0]
        row = (
            self.runs, count, self.rows, self.rows + count, chunk, file, 0, 0, self.bags - 1,
            steps.episode, steps.seed, steps.n_sheep, steps.n_shepherds,
            int(steps.shepherd[first]), int(steps.step[first]),
        )  # fmt: skip
        driver = str(steps.driver[first]) if len(steps.driver) else ''
        texts = {'tasks': [steps.task], 'bag': self._bag, 'driver': driver}
        self._pending.append(dict(zip(NUMBERS, row, strict=True)) | texts)
        self.runs, self.rows = self.runs + 1, self.rows + count

    def _table(self, steps: Steps, chosen: np.ndarray) -> pa.Table:
        """Return the rows of a run."""
        n, (types, n_rays) = len(chosen), self.layout.shape
        ends = types * n
        values = pa.array(steps.lidar[chosen].ravel())
        rays = pa.ListArray.from_arrays(
            pa.array(np.arange(ends + 1, dtype=np.int32) * n_rays), values
        )
        channels = np.arange(n + 1, dtype=np.int32) * types
        frame = np.arange(n)
        columns = (
            pa.ListArray.from_arrays(pa.array(channels), rays),
            pa.FixedSizeListArray.from_arrays(pa.array(steps.action[chosen].ravel()), 2),
            (frame * self.dt).astype(np.float32), frame, np.full(n, self.runs),
            frame + self.rows, np.full(n, self.tasks[steps.task]),
        )  # fmt: skip
        return pa.table(list(columns), schema=STEP_SCHEMA)

    def _flush(self) -> None:
        """Write the pending rows of meta/episodes."""
        if self._pending:
            self._episodes.write_table(pa.Table.from_pylist(self._pending, schema=EPISODE_SCHEMA))
            self._pending.clear()

    def _end_file(self) -> None:
        if self._data is not None:
            self._data.close()
            self._data, self.files = None, self.files + 1

    def _write_meta(self, report: Mapping[str, Any]) -> None:
        """Write the metadata of the data set."""
        rate = 1 / self.dt if self.dt else 0.0
        info = {
            'codebase_version': 'v3.0',
            'robot_type': 'shepherd',
            'total_episodes': self.runs,
            'total_frames': self.rows,
            'total_tasks': len(self.tasks),
            'chunks_size': FILES_PER_CHUNK,
            'data_files_size_in_mb': FILE_SIZE,
            'video_files_size_in_mb': 200,
            'fps': round(rate) if abs(rate - round(rate)) < 1e-9 else rate,
            'splits': {'train': f'0:{self.runs}'},
            'data_path': DATA_PATH,
            'video_path': None,
            'features': features(self.layout),
        }
        meta = {
            'format': DATASET_FORMAT, 'version': __version__, 'dt': self.dt,
            'range_max': self.range_max, 'n_rays': self.layout.n_rays,
            'channels': list(self.layout.channels), 'labels': self.labels, 'bags': self.bags,
            'report': dict(report),
        }  # fmt: skip
        if self.drivers:
            meta['drivers'] = self.drivers
        ranges = {k: [[x] for x in v] for k, v in self._ranges.to_dict().items()}
        stats: dict[str, Any] = {LIDAR: ranges, ACTION: self._actions.to_dict()}
        for name in (LIDAR, ACTION):
            stats[name]['count'] = [self.rows]
        for path, content in ((INFO, info), (ABOUT, meta), (STATS, stats)):
            (self.part / path).write_text(json.dumps(content, indent=1), encoding='utf-8')
        text = pa.array(list(self.tasks), pa.string())
        tasks = pa.table({'task_index': np.arange(len(text)), 'task': text})
        tasks = tasks.replace_schema_metadata({'pandas': json.dumps(INDEXED_BY_TASK)})
        parquet.write_table(tasks, self.part / TASK_TABLE)

    def _unwritable(self, error: OSError) -> BagError:
        reason = f'it cannot be written ({error.strerror or error})'
        return BagError(self.folder, reason, 'free space or choose another folder')


def runs(steps: Steps) -> Iterator[np.ndarray]:
    """Yield the indices (k,) of runs with one driver and without a hole, shepherd by shepherd."""
    for shepherd in np.unique(steps.shepherd):
        (own,) = np.nonzero(steps.shepherd == shepherd)
        ends = np.diff(steps.step[own]) != 1
        if len(steps.driver):
            ends |= steps.driver[own][1:] != steps.driver[own][:-1]
        yield from np.split(own, np.nonzero(ends)[0] + 1)
