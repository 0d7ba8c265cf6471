"""A cell: one setting, one controller, some seeds; cells run anywhere, in any order."""

from __future__ import annotations

from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

import pyarrow as pa  # type: ignore[import-untyped]
from shepherd_ros import __version__
from shepherd_ros.experiments.methods import checkpoint_hash, make_method
from shepherd_ros.experiments.results import cell_key, table_of, value_names, write_rows
from shepherd_ros.experiments.runner import run_episodes
from shepherd_ros.experiments.setting import canonical_setting, env_config, Setting

# episodes of a cell that run in one batch: what a kill costs at most. Per episode, a batch of 50
# takes 0.8 of the time of one of 20 with 100 sheep, and half of it with 10
EPISODES_AT_ONCE = 50


@dataclass(frozen=True)
class Cell:
    """Episodes with seeds first, first + 1, ... of a controller by its full name."""

    setting: Setting
    controller: str
    first: int
    count: int

    def config(self) -> dict[str, Any]:
        """Return environment and controller as plain data."""
        controller = make_method(self.controller, self.setting)
        return {
            'env': env_config(self.setting).to_dict(),
            'controller': {'name': self.controller, **controller.config.to_dict()},
        }

    def cost(self) -> float:
        """Return the estimated time [s] on one core, for the display of the time left."""
        n, m = self.setting.sheep, self.setting.shepherds
        flock = (0.5 + 0.001 * n) * n
        policy = 80.0 * m if self.controller.startswith('policy') else 0.0
        return 1e-6 * (10.0 + flock + policy) * self.count * self.setting.steps


def cell_file(folder: Path, cell: Cell, key: str) -> Path:
    """Return the file of the rows of a cell."""
    name = cell.controller.partition(':')[0]
    return folder / f'{name}-{key}' / f'{cell.first:06d}-{cell.first + cell.count - 1:06d}.parquet'


def run_cell(cell: Cell, code: str = '') -> pa.Table:
    """Return the rows of a cell; code is the commit of the package."""
    config = cell.config()
    controller = make_method(cell.controller, cell.setting)
    result = run_episodes(env_config(cell.setting), controller, cell.first, cell.count)
    checkpoint = checkpoint_hash(cell.controller)
    constants = canonical_setting(cell.setting).to_dict() | {
        'key': cell_key(config, checkpoint, __version__),
        'controller': cell.controller,
        'config': json.dumps(config),
        'checkpoint_sha256': checkpoint,
        'version': __version__,
        'code': code,
    }
    columns: dict[str, Any] = {
        name: result[name].double().tolist() if name in result else [None] * cell.count
        for name in value_names()
    }
    columns['seed'] = list(range(cell.first, cell.first + cell.count))
    return table_of(constants, columns)


def run_into(folder: Path, cell: Cell, key: str, code: str) -> Cell:
    """Run a cell, write its rows, and return it; smaller files that it covers are removed."""
    path = cell_file(folder, cell, key)
    write_rows(path, run_cell(cell, code))
    for other in path.parent.glob('*.parquet'):
        first, last = (int(part) for part in other.stem.split('-'))
        inside = cell.first <= first and last < cell.first + cell.count
        if inside and other != path:
            other.unlink()
    return cell
