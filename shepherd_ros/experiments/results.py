"""Rows of results: one episode each, as Parquet that says everything about itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import cached_property
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
from pyarrow import parquet
from shepherd_ros.config import ConfigError
from shepherd_ros.experiments.setting import FIELDS, Setting
from shepherd_ros.sim.metrics import METRICS

FORMAT = {b'shepherd_ros': b'episodes 1'}
KINDS = {int: pa.int64(), float: pa.float64(), bool: pa.bool_(), str: pa.string()}
VALUES = (*METRICS, 'return')
SCHEMA = pa.schema(
    [
        ('key', pa.string()),  # hash of all that decides the episodes but their seeds
        ('controller', pa.string()),
        *((f.name, KINDS[type(f.default)]) for f in fields(Setting) if f.name in FIELDS),
        ('seed', pa.int64()),
        *((name, pa.float64()) for name in VALUES),
        ('config', pa.string()),  # JSON: environment and controller, whole
        ('checkpoint_sha256', pa.string()),
        ('version', pa.string()),
        ('code', pa.string()),  # commit, if the package ran from a checkout
    ],
    metadata=FORMAT,
)


def table_of(constants: Mapping[str, Any], columns: Mapping[str, Sequence[Any]]) -> pa.Table:
    """Return rows with these columns, and constants that are the same in all."""
    count = len(next(iter(columns.values())))
    arrays = [
        pa.array(columns[f.name] if f.name in columns else [constants[f.name]] * count, f.type)
        for f in SCHEMA
    ]
    return pa.table(arrays, schema=SCHEMA)


def write_rows(path: Path, table: pa.Table) -> None:
    """Write rows beside and move them into place, so that a reader never sees half of them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f'.{path.name}.part')
    parquet.write_table(table, beside, compression='zstd')
    beside.replace(path)


def files_of(paths: Sequence[Path]) -> list[Path]:
    """Return the Parquet files that are named or lie in folders, or raise ConfigError."""
    found: list[Path] = []
    for path in paths:
        if not path.exists():
            raise ConfigError(f'{path} is not there: expected rows as shepherd evaluate writes')
        inside = sorted(path.rglob('*.parquet')) if path.is_dir() else [path]
        if not inside:
            raise ConfigError(f'{path} has no Parquet files: run shepherd evaluate first')
        found += inside
    return found


def read_table(path: Path) -> pa.Table:
    """Return the rows of one file, or raise ConfigError if it is not one of ours."""
    try:
        table = parquet.read_table(path)
    except (pa.ArrowException, OSError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f'{path} is no whole Parquet file ({reason})') from error
    if (table.schema.metadata or {}).get(b'shepherd_ros') != FORMAT[b'shepherd_ros']:
        raise ConfigError(
            f'{path} is no table of episodes: expected what shepherd evaluate writes'
        )
    if table.schema.names != SCHEMA.names or table.schema.types != SCHEMA.types:
        raise ConfigError(f'{path} has other columns: run shepherd evaluate again')
    return table


class Rows:
    """Episodes of many cells, as columns."""

    def __init__(self, table: pa.Table) -> None:
        """Keep each episode once: with the same key and seed it is the same."""
        key, seed = (table.column(name).to_numpy() for name in ('key', 'seed'))
        order = np.lexsort((seed, key))
        first = np.ones(len(order), bool)
        first[1:] = (key[order][1:] != key[order][:-1]) | (seed[order][1:] != seed[order][:-1])
        self.table = table.take(pa.array(order[first]))
        self.columns = {
            name: self.table.column(name).to_numpy() for name in SCHEMA.names if name != 'config'
        }

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self.columns['seed'])

    def where(self, **values: Any) -> np.ndarray:
        """Return which rows have these values, (rows,) bool."""
        mask = np.ones(len(self), bool)
        for name, value in values.items():
            mask &= self.columns[name] == value
        return mask

    def in_environment(self, environment: Mapping[str, Any]) -> np.ndarray:
        """Return which rows are of this environment, whatever its setting was called; (rows,)."""
        keys = [key for key, found in self._environments.items() if found == environment]
        return np.isin(self.columns['key'], keys)

    @cached_property
    def _environments(self) -> dict[str, Any]:
        """The configuration of the environment by key."""
        _, first = np.unique(self.columns['key'], return_index=True)
        few = self.table.select(['key', 'config']).take(pa.array(first)).to_pylist()
        return {row['key']: json.loads(row['config']).get('env') for row in few}

    def distinct(self, name: str) -> list[Any]:
        """Return the values of a column, ascending."""
        return sorted(set(self.columns[name].tolist()))


def read_rows(paths: Sequence[Path]) -> Rows:
    """Return the rows of files and folders, or raise ConfigError."""
    return Rows(pa.concat_tables([read_table(path) for path in files_of(paths)]))
