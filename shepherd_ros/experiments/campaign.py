"""Plan and run of the missing cells of experiments."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, replace
from multiprocessing import get_context, parent_process
import os
from pathlib import Path
from threading import Thread

import numpy as np
from shepherd_ros import __version__
from shepherd_ros.config import ConfigError
from shepherd_ros.experiments.cells import Cell, EPISODES_AT_ONCE, run_into
from shepherd_ros.experiments.methods import checkpoint_hash, full_name
from shepherd_ros.experiments.results import cell_key, Results
from shepherd_ros.experiments.setting import canonical_setting, Setting
from shepherd_ros.memory import keep_memory
import torch


@dataclass(frozen=True)
class CellTask:
    """A cell and the key of its rows."""

    cell: Cell
    key: str


def seed_batches(seed: int, episodes: int) -> Iterator[tuple[int, int]]:
    """Yield first seed and number of the batches of a cell; always cut at the same places."""
    for first in range(seed, seed + episodes, EPISODES_AT_ONCE):
        yield first, min(EPISODES_AT_ONCE, seed + episodes - first)


def plan(
    settings: Sequence[Setting], controllers: Sequence[str], seed: int, episodes: int
) -> list[CellTask]:
    """Return all cells, each once; raises ConfigError for one that cannot run."""
    if episodes < 1:
        raise ConfigError(f'--episodes is {episodes}: expected at least 1')
    tasks: dict[tuple[str, int], CellTask] = {}
    for name in dict.fromkeys(map(full_name, controllers)):
        for setting in dict.fromkeys(map(canonical_setting, settings)):
            whole = Cell(setting, name, seed, episodes)
            key = cell_key(whole.config(), checkpoint_hash(name), __version__)
            for first, count in seed_batches(seed, episodes):
                cell = replace(whole, first=first, count=count)
                tasks.setdefault((key, first), CellTask(cell, key))
    return list(tasks.values())


def done_of(tasks: Iterable[CellTask], rows: Results) -> set[CellTask]:
    """Return the tasks whose rows are all present."""
    return {
        task
        for task in tasks
        if rows.seeds.get(task.key, set()).issuperset(
            range(task.cell.first, task.cell.first + task.cell.count)
        )
    }


def codes_of(tasks: Iterable[CellTask], rows: Results) -> list[str]:
    """Return the commits that made the rows of done cells, ascending."""
    of_tasks = np.isin(rows.columns['key'], list({task.key for task in tasks}))
    return sorted(set(rows.columns['code'][of_tasks].tolist()))


def shard_of(tasks: Sequence[CellTask], shard: str) -> list[CellTask]:
    """Return the part i/n of the cells, as 1/4, so that n machines share the work."""
    try:
        index, count = (int(part) for part in shard.split('/'))
    except ValueError:
        index, count = 0, 0
    if not 1 <= index <= count:
        raise ConfigError(f'--shard is {shard!r}: expected i/n with 1 <= i <= n, such as 1/4')
    return list(tasks[index - 1 :: count])


def take_one_thread() -> None:
    """Compute in one thread, and keep freed memory, in whatever process runs cells."""
    torch.set_num_threads(1)
    keep_memory()


def start_worker() -> None:
    """Set a worker process up: one thread, and an end with its parent."""
    take_one_thread()

    def end_with_parent() -> None:
        parent = parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    Thread(target=end_with_parent, daemon=True).start()


def run_tasks(
    folder: Path,
    tasks: Sequence[CellTask],
    workers: int,
    code: str,
    on_done: Callable[[Cell], None],
) -> None:
    """Run cells, several in processes of their own, long ones first; on_done(cell) after each."""
    longest = sorted(tasks, key=lambda task: -task.cell.cost())
    if workers == 1:
        take_one_thread()
        for task in longest:
            on_done(run_into(folder, task.cell, task.key, code))
        return
    with ProcessPoolExecutor(workers, get_context('spawn'), start_worker) as pool:
        running: set[Future[Cell]] = {
            pool.submit(run_into, folder, task.cell, task.key, code) for task in longest
        }
        try:
            while running:
                ended, running = wait(running, return_when=FIRST_COMPLETED)
                for future in ended:
                    on_done(future.result())
        except BaseException:  # Ctrl-C, too: what has not begun is not begun
            pool.shutdown(wait=False, cancel_futures=True)
            raise
