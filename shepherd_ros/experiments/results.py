"""Rows of results, one for each episode, as Parquet with their configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import cache, cached_property
import hashlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
from pyarrow import parquet
from shepherd_ros.config import ConfigError, mapping
from shepherd_ros.controllers import CONTROLLERS
from shepherd_ros.experiments.setting import Setting, SETTING_FIELDS
from shepherd_ros.sim.env import EnvConfig
from shepherd_ros.sim.metrics import METRICS
from shepherd_ros.sim.tasks import TASKS

RESULTS_FORMAT = {b'shepherd_ros': b'episodes 1'}
ARROW_TYPES = {int: pa.int64(), float: pa.float64(), bool: pa.bool_(), str: pa.string()}


def value_names() -> tuple[str, ...]:
    """Return the names of the values of episodes: the metrics of all tasks and `return`."""
    metrics = dict.fromkeys(name for task in TASKS.values() for name in task.metrics)
    return (*metrics, 'return')


def schema() -> pa.Schema:
    """Return the schema of the rows."""
    return pa.schema(
        [
            ('key', pa.string()),  # cell_key() of environment, controller and version
            ('controller', pa.string()),
            *(
                (f.name, ARROW_TYPES[type(f.default)])
                for f in fields(Setting)
                if f.name in SETTING_FIELDS
            ),
            ('seed', pa.int64()),
            *((name, pa.float64()) for name in value_names()),
            ('config', pa.string()),  # JSON: environment and controller, whole
            ('checkpoint_sha256', pa.string()),
            ('version', pa.string()),
            ('code', pa.string()),  # commit, if the package ran from a checkout
        ],
        metadata=RESULTS_FORMAT,
    )


def cell_key(config: Mapping[str, Any], checkpoint: str, version: str) -> str:
    """
    Return the hash that identifies the rows of a cell, or raise ConfigError.

    config is the complete environment and controller. Only values that differ from the defaults
    count, so that a new option changes no key.
    """
    options = dict(mapping('controller', config.get('controller')))
    name = str(options.pop('name', ''))
    kind = CONTROLLERS[name.partition(':')[0]].config_type
    changes = {
        'env': EnvConfig.from_dict(mapping('env', config.get('env'))).changes(),
        'controller': {'name': name, **kind.from_dict(options).changes()},
    }
    text = json.dumps([changes, checkpoint, version], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@cache
def _stored_key(key: str, config: str, checkpoint: str, version: str) -> str:
    """Return the key of a stored row; the stored one if its configuration is not known here."""
    try:
        return cell_key(json.loads(config), checkpoint, version)
    except ConfigError:
        return key


def table_of(constants: Mapping[str, Any], columns: Mapping[str, Sequence[Any]]) -> pa.Table:
    """Return rows with these columns, and constants that are the same in all."""
    count = len(next(iter(columns.values())))
    arrays = [
        pa.array(columns[f.name] if f.name in columns else [constants[f.name]] * count, f.type)
        for f in schema()
    ]
    return pa.table(arrays, schema=schema())


def write_rows(path: Path, table: pa.Table) -> None:
    """Write rows under another name and rename the file, so that a reader never sees a part."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f'.{path.name}.part')
    parquet.write_table(table, temporary, compression='zstd')
    temporary.replace(path)


def files_of(paths: Sequence[Path]) -> list[Path]:
    """Return the Parquet files among paths and in folders, or raise ConfigError."""
    files: list[Path] = []
    for path in paths:
        if not path.exists():
            raise ConfigError(f'{path} is not there: expected rows as shepherd evaluate writes')
        inside = sorted(path.rglob('*.parquet')) if path.is_dir() else [path]
        if not inside:
            raise ConfigError(f'{path} has no Parquet files: run shepherd evaluate first')
        files += inside
    return files


def read_table(path: Path) -> pa.Table:
    """
    Return the rows of one file, or raise ConfigError if it is not one of ours.

    A missing option of the setting gets its default, a missing metric NaN, or null if it is one of
    another task; unknown columns are left out. Keys are those of this version, whatever the file
    holds.
    """
    try:
        table = parquet.read_table(path)
    except (pa.ArrowException, OSError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f'{path} is no whole Parquet file ({reason})') from error
    if (table.schema.metadata or {}).get(b'shepherd_ros') != RESULTS_FORMAT[b'shepherd_ros']:
        raise ConfigError(
            f'{path} is no table of episodes: expected what shepherd evaluate writes'
        )
    others = set(value_names()) - {*METRICS, 'return'}  # metrics of other tasks
    defaults = Setting().to_dict() | dict.fromkeys(value_names(), math.nan)
    defaults |= dict.fromkeys(others, None)
    types = dict(zip(table.schema.names, table.schema.types, strict=True))
    arrays = []
    for f in schema():
        if types.get(f.name, f.type if f.name in defaults else None) != f.type:
            raise ConfigError(
                f'{path} has other columns: {f.name} is {types.get(f.name, "not there")}, '
                f'expected {f.type}; run shepherd evaluate again'
            )
        missing = [] if f.name in types else [defaults[f.name]] * len(table)
        arrays.append(table.column(f.name) if f.name in types else pa.array(missing, f.type))
    identity = ('key', 'config', 'checkpoint_sha256', 'version')
    rows = zip(*(table.column(name).to_pylist() for name in identity), strict=True)
    arrays[0] = pa.array([_stored_key(*row) for row in rows], pa.string())
    return pa.table(arrays, schema=schema())


class Results:
    """Episodes of many cells, as columns."""

    def __init__(self, table: pa.Table) -> None:
        """Keep one row for each key and seed."""
        key, seed = (table.column(name).to_numpy() for name in ('key', 'seed'))
        order = np.lexsort((seed, key))
        first = np.ones(len(order), bool)
        first[1:] = (key[order][1:] != key[order][:-1]) | (seed[order][1:] != seed[order][:-1])
        self.table = table.take(pa.array(order[first]))
        names = [name for name in self.table.schema.names if name != 'config']
        self.columns = {name: self.table.column(name).to_numpy() for name in names}

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self.columns['seed'])

    def where(self, **values: Any) -> np.ndarray:
        """Return the mask of the rows with these values, (rows,) bool."""
        mask = np.ones(len(self), bool)
        for name, value in values.items():
            mask &= self.columns[name] == value
        return mask

    def chosen(self, **values: Any) -> Results:
        """Return the rows with these values."""
        return Results(self.table.filter(pa.array(self.where(**values))))

    def in_environment(self, environment: EnvConfig) -> np.ndarray:
        """Return the mask of the rows of this environment, with any length; (rows,) bool."""
        return np.isin(self.columns['key'], self._keys.get(_timeless(environment), []))

    @cached_property
    def _keys(self) -> dict[EnvConfig, list[str]]:
        """Keys by environment, without its number of steps."""
        _, first = np.unique(self.columns['key'], return_index=True)
        keys: dict[EnvConfig, list[str]] = {}
        for row in self.table.select(['key', 'config']).take(pa.array(first)).to_pylist():
            try:
                env = mapping('env', json.loads(row['config']).get('env'))
                environment = _timeless(EnvConfig.from_dict(env))
            except ConfigError:  # of something that is not known here
                continue
            keys.setdefault(environment, []).append(row['key'])
        return keys

    @cached_property
    def seeds(self) -> dict[str, set[int]]:
        """Seeds of the episodes by key."""
        seeds: dict[str, set[int]] = {}
        for key, seed in zip(self.columns['key'], self.columns['seed'], strict=True):
            seeds.setdefault(key, set()).add(int(seed))
        return seeds

    def distinct(self, name: str) -> list[Any]:
        """Return the values of a column, ascending."""
        return sorted(set(self.columns[name].tolist()))


def _timeless(environment: EnvConfig) -> EnvConfig:
    """Return an environment with the default number of steps."""
    steps = EnvConfig().world.episode_steps
    return replace(environment, world=replace(environment.world, episode_steps=steps))


def results_in(folder: Path) -> Results:
    """Return the rows of a folder, empty without files; or raise ConfigError."""
    paths = sorted(folder.rglob('*.parquet'))
    return read_results(paths) if paths else Results(schema().empty_table())


def read_results(paths: Sequence[Path]) -> Results:
    """Return the rows of files and folders, or raise ConfigError."""
    return Results(pa.concat_tables([read_table(path) for path in files_of(paths)]))
