"""Bags as tables for other tools: Parquet or CSV, one episode in memory at a time."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
from pyarrow import csv, parquet
from shepherd_ros.config import unknown_name
from shepherd_ros.recordings.episodes import Frame, iter_episodes, one_namespace, RecordedEpisode
from shepherd_ros.recordings.grouping import RecordedGroups
from shepherd_ros.rosbag2.bag import Bag
from shepherd_ros.rosbag2.errors import BagError

FORMATS = ('parquet', 'csv')
_KEY = [('episode', pa.int64()), ('step', pa.int64()), ('stamp_ns', pa.int64())]
_XY = [('x', pa.float64()), ('y', pa.float64())]
_HEADING = [('heading_x', pa.float64()), ('heading_y', pa.float64())]
_GOAL = [('goal_x', pa.float64()), ('goal_y', pa.float64())]
SCHEMAS = {
    'episodes': pa.schema(
        [('episode', pa.int64()), ('number', pa.int64()), ('seed', pa.int64()),
         ('n_sheep', pa.int64()), ('n_shepherds', pa.int64()), ('dt', pa.float64()),
         ('episode_steps', pa.int64()), ('states', pa.int64()), ('whole', pa.bool_()),
         ('config', pa.string())]
    ),
    'states': pa.schema(
        [*_KEY, ('kind', pa.string()), ('index', pa.int64()), *_XY, *_HEADING, *_GOAL]
    ),
    'scans': pa.schema(
        [*_KEY, ('shepherd', pa.int64())]  # and a column for each channel
    ),
    'commands': pa.schema([*_KEY, ('shepherd', pa.int64()), *_XY]),
}  # fmt: skip


def schemas_of(channels: tuple[str, ...]) -> dict[str, pa.Schema]:
    """Return the schemas of the tables by name; that of scans has a column for each channel."""
    ranges = [pa.field(name, pa.list_(pa.float32())) for name in channels]
    return SCHEMAS | {'scans': pa.schema([*SCHEMAS['scans'], *ranges])}


@dataclass(frozen=True)
class Exported:
    """A written table: its file and its number of rows."""

    path: Path
    rows: int


def export_bag(
    bag: Bag, folder: Path | str, kind: str = 'parquet', namespace: str | None = None
) -> dict[str, Exported]:
    """
    Write the tables episodes, states, scans and commands into a folder; raises BagError.

    The column episode counts the episodes of the bag from 0. In CSV the ranges of a scan are one
    text with spaces between them, inf for no return.
    """
    folder = Path(folder)
    if kind not in FORMATS:
        raise unknown_name('kind', kind, FORMATS)
    paths = {name: folder / f'{name}.{kind}' for name in SCHEMAS}
    for path in paths.values():
        if path.exists():
            raise BagError(path, 'it exists already', 'choose another folder or remove it')
    rows = dict.fromkeys(SCHEMAS, 0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            schemas = schemas_of(RecordedGroups(bag, one_namespace(bag, namespace)).channels)
            writers = {
                name: stack.enter_context(_table_writer(path, kind, schemas[name]))
                for name, path in paths.items()
            }
            for index, episode in enumerate(iter_episodes(bag, namespace)):
                for name, table in tables(index, episode).items():
                    writers[name].write_table(_flat(table) if kind == 'csv' else table)
                    rows[name] += table.num_rows
    except BaseException as error:
        for path in paths.values():
            with suppress(OSError):
                path.unlink()
        if isinstance(error, OSError):
            reason = f'it cannot be written ({error.strerror or error})'
            raise BagError(folder, reason, 'free space or choose another folder') from error
        raise
    return {name: Exported(path, rows[name]) for name, path in paths.items()}


def tables(index: int, episode: RecordedEpisode) -> dict[str, pa.Table]:
    """Return the rows of one episode, by name of the table."""
    frames = episode.frames
    members = [('sheep', k) for k in range(episode.n_sheep)]
    members += [('shepherd', k) for k in range(episode.n_shepherds)]
    place = np.concatenate(
        [np.zeros((0, 2))] + [_concatenated(f.sheep, f.shepherds) for f in frames]
    )
    heading = np.concatenate(
        [np.zeros((0, 2))] + [_concatenated(f.sheep_heading, f.shepherd_heading) for f in frames]
    )
    goal = np.array([_goal(frame) for frame in frames]).reshape(-1, 2).repeat(len(members), axis=0)
    scanned = [(f, h, s) for f in frames for h, s in enumerate(f.scans) if s is not None]
    answered = [(f, h, c) for f in frames for h, c in enumerate(f.commands) if c is not None]
    columns: dict[str, dict[str, Any]] = {
        'episodes': {
            'episode': [index],
            'states': [len(frames)],
            'whole': [episode.whole],
            'config': [episode.to_json()],
            **{
                name: [getattr(episode, name)]
                for name in SCHEMAS['episodes'].names
                if hasattr(episode, name) and name not in ('whole', 'config')
            },
        },
        'states': {
            **_key(index, [frame for frame in frames for _ in members]),
            'kind': [kind for kind, _ in members] * len(frames),
            'index': [number for _, number in members] * len(frames),
            'x': place[:, 0], 'y': place[:, 1],
            'heading_x': heading[:, 0], 'heading_y': heading[:, 1],
            'goal_x': goal[:, 0], 'goal_y': goal[:, 1],
        },
        'scans': {
            **_key(index, [frame for frame, _, _ in scanned]),
            'shepherd': [h for _, h, _ in scanned],
            **{c: [s[k] for _, _, s in scanned] for k, c in enumerate(episode.channels)},
        },
        'commands': {
            **_key(index, [frame for frame, _, _ in answered]),
            'shepherd': [h for _, h, _ in answered],
            'x': [c[0] for _, _, c in answered], 'y': [c[1] for _, _, c in answered],
        },
    }  # fmt: skip
    schemas = schemas_of(episode.channels)
    return {name: pa.table(columns[name], schema=schema) for name, schema in schemas.items()}


def _key(index: int, frames: list[Frame]) -> dict[str, list[int]]:
    """Return the columns that identify the state of a row."""
    return {
        'episode': [index] * len(frames),
        'step': [frame.step for frame in frames],
        'stamp_ns': [frame.stamp_ns for frame in frames],
    }


def _concatenated(sheep: np.ndarray, shepherds: np.ndarray) -> np.ndarray:
    return np.concatenate([sheep, shepherds])


def _goal(frame: Frame) -> np.ndarray:
    return np.full(2, np.nan) if frame.goal is None else frame.goal


def _table_writer(path: Path, kind: str, schema: pa.Schema) -> Any:
    """Return a writer with write_table(), for a with statement."""
    if kind == 'parquet':
        return parquet.ParquetWriter(path, schema, compression='zstd')
    return csv.CSVWriter(path, _flat(schema.empty_table()).schema)


def _flat(table: pa.Table) -> pa.Table:
    """Return a table with its lists as text, for CSV."""
    for k, f in enumerate(table.schema):
        if pa.types.is_list(f.type):
            texts = [' '.join(f'{x:.9g}' for x in row) for row in table[k].to_pylist()]
            table = table.set_column(k, f.name, pa.array(texts, pa.string()))
    return table
