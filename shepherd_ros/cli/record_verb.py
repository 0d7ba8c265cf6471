"""Verb record: episodes of the environment as bags, without ROS running."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import as_completed, ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal, TYPE_CHECKING

from shepherd_ros.cli.out_folders import own_folder
from shepherd_ros.cli.progress import progress
from shepherd_ros.cli.user_error import UserError
from shepherd_ros.experiments.setting_arguments import OneSetting

if TYPE_CHECKING:
    from shepherd_ros.controllers.controller import Controller
    from shepherd_ros.sim.rollout import EnvConfig

EPISODES_PER_BATCH = 8  # episodes that a worker runs in one batch


@dataclass(kw_only=True)
class Record(OneSetting):
    """Run a controller in simulation and write every episode as a bag."""

    out: Path
    """Folder of the bags, episode_<seed> each; those of the same options are kept."""
    resume: bool = False
    """Go on in a folder that holds something else."""
    overwrite: bool = False
    """Delete the episodes that are in the folder."""
    controller: str = 'strombom'
    """Controller that commands the shepherds."""
    episodes: int = 100
    """Episodes, with seeds seed, seed + 1, ..."""
    seed: int = 0
    """Seed of the first episode."""
    training: bool = False
    """Start as in training: 1 to 6 shepherds, goals of 4 to 8 m."""
    compression: Literal['none', 'zstd', 'lz4'] = 'none'
    """Compression of the bags."""
    workers: int = 1
    """Processes that run at the same time."""

    def run(self) -> int:
        """Record all; return the exit code."""
        for name in ('episodes', 'workers'):
            if getattr(self, name) < 1:
                raise UserError(f'--{name} is {getattr(self, name)}: expected at least 1')
        self.world = self.setting  # which other processes can be given
        own_folder(self.out, self.made_by(), self.resume, self.overwrite)
        from shepherd_ros.recordings.record import episode_folder

        seeds = range(self.seed, self.seed + self.episodes)
        parts = [
            range(start, min(start + EPISODES_PER_BATCH, seeds.stop))
            for start in seeds[::EPISODES_PER_BATCH]
        ]
        open_parts = [
            part for part in parts if not all(episode_folder(self.out, s).exists() for s in part)
        ]
        with progress('recording', self.episodes) as show:
            done = sum(len(part) for part in parts if part not in open_parts)
            show(done)
            for count in self.recorded(open_parts):
                done += count
                show(done, text=f'{done} of {self.episodes} episodes')
        print(f'{self.episodes} bags in {self.out}')
        return 0

    def recorded(self, parts: list[range]) -> Iterator[int]:
        """Record parts, several in processes of their own; yield how many episodes after each."""
        if self.workers == 1:
            yield from (record_part(self, part) for part in parts)
            return
        with ProcessPoolExecutor(self.workers, get_context('spawn')) as pool:
            futures = [pool.submit(record_part, self, part) for part in parts]
            yield from (future.result() for future in as_completed(futures))

    def made_by(self) -> dict[str, Any]:
        """Return what decides the episodes; refuses what cannot be, before any process starts."""
        from shepherd_ros.experiments.methods import checkpoint_hash, full_name

        name = full_name(self.controller)
        world = self.environment()[0].to_dict()
        return {'controller': name, 'checkpoint': checkpoint_hash(name), 'environment': world}

    def environment(self) -> tuple[EnvConfig, Controller]:
        """Return environment and controller, or raise ConfigError."""
        from shepherd_ros.experiments.methods import full_name, lidar_in, method_in
        from shepherd_ros.experiments.setting import env_config
        from shepherd_ros.sim.presets import training_world

        config = env_config(self.setting)
        if self.training:
            config = replace(config, world=training_world(config.world))
        name = full_name(self.controller)
        method = method_in(config, name)
        return replace(config, lidar=lidar_in(config, name)), method


def record_part(options: Record, seeds: range) -> int:
    """Record some episodes in one thread; return how many."""
    from shepherd_ros.memory import keep_memory
    from shepherd_ros.recordings.record import episode_folder, record_episodes
    import torch

    torch.set_num_threads(1)
    keep_memory()
    config, controller = options.environment()
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
