"""Folders, files and columns of a data set in the form of LeRobot 3.0, and columns of our own."""

from __future__ import annotations

from typing import Any

import pyarrow as pa  # type: ignore[import-untyped]
from shepherd_ros.sim.lidar_layout import ScanLayout

DATASET_FORMAT = 'shepherd_ros data set 1'
DATA_PATH = 'data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet'
EPISODES_PATH = 'meta/episodes/chunk-000/file-000.parquet'
INFO, ABOUT, STATS, TASK_TABLE = (
    f'meta/{name}' for name in ('info.json', 'shepherd_ros.json', 'stats.json', 'tasks.parquet')
)
FILE_SIZE = 100  # [MiB] after which a data file is full
FILES_PER_CHUNK = 1000  # files of a folder
LIDAR, ACTION = 'observation.lidar', 'action'
_LONG = pa.int64()
STEP_SCHEMA = pa.schema(
    [(LIDAR, pa.list_(pa.list_(pa.float32()))), (ACTION, pa.list_(pa.float32(), 2)),
     ('timestamp', pa.float32()), ('frame_index', _LONG), ('episode_index', _LONG),
     ('index', _LONG), ('task_index', _LONG)]
)  # fmt: skip
INDEXED_BY_TASK = {  # metadata for pandas, with which LeRobot reads it
    'index_columns': ['task'],
    'column_indexes': [],
    'columns': [
        {
            'name': name,
            'field_name': name,
            'pandas_type': kind,
            'numpy_type': numpy_type,
            'metadata': None,
        }
        for name, kind, numpy_type in (
            ('task_index', 'int64', 'int64'),
            ('task', 'unicode', 'object'),
        )
    ],
}
NUMBERS = (
    'episode_index', 'length', 'dataset_from_index', 'dataset_to_index', 'data/chunk_index',
    'data/file_index', 'meta/episodes/chunk_index', 'meta/episodes/file_index', 'bag_index',
    'recorded_episode', 'seed', 'n_sheep', 'n_shepherds', 'shepherd', 'first_step',
)  # fmt: skip
EPISODE_SCHEMA = pa.schema(
    [*((name, _LONG) for name in NUMBERS), ('tasks', pa.list_(pa.string())), ('bag', pa.string()),
     ('driver', pa.string())]
)  # fmt: skip


def features(layout: ScanLayout) -> dict[str, Any]:
    """Return the features of LeRobot: dtype, shape and names by column."""
    whole = {name: ('int64', [1], None) for name in STEP_SCHEMA.names[3:]}
    columns = {
        LIDAR: ('float32', list(layout.shape), ['channel', 'ray']),
        ACTION: ('float32', [2], ['x', 'y']),
        'timestamp': ('float32', [1], None),
        **whole,
    }
    return {
        name: {'dtype': kind, 'shape': shape, 'names': names}
        for name, (kind, shape, names) in columns.items()
    }
