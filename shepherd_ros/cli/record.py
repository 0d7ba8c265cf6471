"""Verb record: episodes of the environment as bags, without ROS running."""

from __future__ import annotations

from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Literal, TYPE_CHECKING

from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn
from shepherd_ros.cli.errors import UserError

if TYPE_CHECKING:
    from shepherd_ros.controllers.base import Controller
    from shepherd_ros.sim.rollout import EnvConfig

TOGETHER = 8  # episodes that a worker runs in one batch


@dataclass
class Record:
    """Run a controller in simulation and write every episode as a bag."""

    out: Path
    """Folder of the bags, episode_<seed> each; those that are there already are kept."""
    controller: str = 'strombom'
    """Controller that commands the shepherds."""
    episodes: int = 100
    """Episodes, with seeds seed, seed + 1, ..."""
    seed: int = 0
    """Seed of the first episode."""
    sheep: int = 100
    """Sheep in the flock."""
    shepherds: int = 3
    """Shepherds."""
    flock: str = 'strombom'
    """Flock model."""
    preset: str = 'default'
    """Named setting of time step and flock."""
    steps: int = 1000
    """Steps of an episode."""
    training: bool = False
    """Start as in training: 1 to 6 shepherds, goals of 4 to 8 m, 100 sheep."""
    noise: float = 0.0
    """Standard deviation of the noise on perceived positions [m]."""
    compression: Literal['none', 'zstd', 'lz4'] = 'none'
    """Compression of the bags."""
    workers: int = 1
    """Processes that run at the same time."""

    def run(self) -> int:
        """Record all; return the exit code."""
        for name in ('episodes', 'workers'):
            if getattr(self, name) < 1:
                raise UserError(f'--{name} is {getattr(self, name)}: expected at least 1')
        self.setting()  # refuses what cannot be, before any process starts
        try:
            self.out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f'--out is {self.out}: expected a folder ({error.strerror})') from None
        from shepherd_ros.recordings.record import episode_folder

        seeds = range(self.seed, self.seed + self.episodes)
        parts = [range(start, min(start + TOGETHER, seeds.stop)) for start in seeds[::TOGETHER]]
        open_parts = [
            part for part in parts if not all(episode_folder(self.out, s).exists() for s in part)
        ]
        columns = (*Progress.get_default_columns()[:2], MofNCompleteColumn())
        with (
            ProcessPoolExecutor(self.workers, get_context('spawn')) as pool,
            Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn()) as progress,
        ):
            task = progress.add_task('episodes', total=self.episodes)
            done = sum(len(part) for part in parts if part not in open_parts)
            progress.update(task, completed=done)
            running: set[Future[int]] = {pool.submit(record_part, self, p) for p in open_parts}
            while running:
                ended, running = wait(running, return_when=FIRST_COMPLETED)
                for future in ended:
                    progress.advance(task, future.result())
        print(f'{self.episodes} bags in {self.out}')
        return 0

    def setting(self) -> tuple[EnvConfig, Controller]:
        """Return environment and controller, or raise ConfigError."""
        from shepherd_ros.controllers import make_controller
        from shepherd_ros.sim.presets import training_world, world_preset
        from shepherd_ros.sim.rollout import EnvConfig

        world = replace(
            world_preset(self.preset, self.flock),
            n_sheep=self.sheep,
            n_shepherds=self.shepherds,
            episode_steps=self.steps,
        )
        world = training_world(world) if self.training else world
        controller = make_controller(self.controller, world)
        return EnvConfig(world=world, noise_std=self.noise), controller


def record_part(options: Record, seeds: range) -> int:
    """Record some episodes in a process of its own; return how many."""
    from shepherd_ros.memory import keep_memory
    from shepherd_ros.recordings.record import episode_folder, record_episodes
    import torch

    torch.set_num_threads(1)
    keep_memory()
    config, controller = options.setting()
    missing = [s for s in seeds if not episode_folder(options.out, s).exists()]
    for first in missing:  # runs of neighbours, so that a batch is a range
        if first - 1 in missing:
            continue
        last = first
        while last + 1 in missing:
            last += 1
        record_episodes(
            config, controller, range(first, last + 1), options.out, options.compression
        )
    return len(seeds)
