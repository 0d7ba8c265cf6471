"""
Bags of DAgger: the executed episodes, with the teacher's commands as labels.

The commands of such a bag are those that moved its world, so it is a bag like any other. The
labels of the teacher are on the same topics in a namespace of their own, as if the teacher ran
beside the learner and only the learner's commands were remapped to the world.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import shutil

from shepherd_ros.config import ConfigError
from shepherd_ros.learning.group import WorldGroup
from shepherd_ros.recordings.record import (
    close_bags,
    episode_folder,
    EpisodeBag,
    open_bags,
    write_moment,
)
from shepherd_ros.sim.rollout import Moment
from torch import Tensor

LABEL_NAMESPACE = 'teacher'  # namespace


class DaggerBags:
    """Writes the episodes of a group of worlds, a bag for each world and episode."""

    def __init__(self, out: Path | str, again: bool = False, compression: str = 'zstd') -> None:
        """
        Set the folder of the bags, none if it is empty; it is created with the first bag.

        again: a resumed run, which overwrites its bags.
        """
        self.out = Path(out) if out else None
        self.again, self.compression = again, compression
        self.bags: list[EpisodeBag] = []

    def add(self, group: WorldGroup, executed: Tensor, labels: Tensor) -> None:
        """
        Write the group's states (B) with their scans, before the step of the command.

        executed and labels (B, H, 2) m/s are the commands to the worlds, and the teacher's.
        Raises ConfigError if a bag exists.
        """
        if self.out is None:
            return
        if not self.bags:
            self._begin(self.out, group)
        write_moment(self.bags, group.moment, executed, (LABEL_NAMESPACE, labels))

    def close(self, last: Moment) -> None:
        """Write the moment after the last command, and close the bags."""
        if self.out is not None and self.bags:
            write_moment(self.bags, last)
            close_bags(self.out, self.bags)
        self.bags = []

    def _begin(self, out: Path, group: WorldGroup) -> None:
        """Open the bags of an episode, with the length that it will have."""
        start = group.moment.state
        for seed in start.seed.tolist():
            folder = episode_folder(out, seed)
            if folder.exists() and self.again:
                shutil.rmtree(folder)
            elif folder.exists():
                raise ConfigError(
                    f'bag_folder is {str(out)!r}: {folder.name} is there already; choose another '
                    'folder or remove it'
                )
        out.mkdir(parents=True, exist_ok=True)
        world = group.moment.config.world
        world = replace(world, episode_steps=int(start.step[0]) + group.left)
        self.bags = open_bags(out, world, start, self.compression)
