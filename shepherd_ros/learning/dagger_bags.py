"""
Where a learner went, as bags: driven by whoever drove, with what the teacher would have done.

The commands of such a bag are those that moved its world, so it is a bag like any other. The
labels of the teacher are on the same topics in a namespace of their own, as they would be if the
teacher ran beside the learner and only the learner's commands were remapped to the world.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from shepherd_ros.config import ConfigError
from shepherd_ros.learning.rollout import Group
from shepherd_ros.recordings.record import close_bags, episode_folder, EpisodeBag, open_bags
from shepherd_ros.sim.lidar import LidarConfig, scan
from shepherd_ros.sim.metrics import count_step, METRICS, metrics, MetricsTally, start_tally
from shepherd_ros.sim.perception import perceive
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.transition import step
from torch import Tensor

LABELS = 'teacher'  # namespace


class Visits:
    """Writes the episodes of a group of worlds, a bag for each world and episode."""

    def __init__(self, out: Path | str, lidar: LidarConfig, compression: str = 'zstd') -> None:
        """Take the folder of the bags, none if it is empty; it is made with the first bag."""
        self.out = Path(out) if out else None
        self.lidar, self.compression = lidar, compression
        self.bags: list[EpisodeBag] = []
        self.episode = -1

    state: WorldState  # to which the last command leads
    before: WorldState
    tally: MetricsTally

    def add(self, group: Group, driven: Tensor, labels: Tensor) -> None:
        """
        Write the group's states (B) with their scans, before they go on as commanded.

        driven and labels (B, H, 2) m/s are what moves the worlds, and what the teacher would say.
        Raises ConfigError if a bag is there already.
        """
        if self.out is None:
            return
        if group.episode != self.episode:
            self.close()
            self._begin(self.out, group)
        if not self.bags:
            return
        self._write(group.state, driven, labels)
        self.before, self.state = group.state, step(group.state, driven, group.config.world)
        self.tally = count_step(self.tally, self.before, self.state)

    def close(self) -> None:
        """Write the state that the last command led to, and finish the bags."""
        if self.out is not None and self.bags:
            self._write(self.state, None, None)
            close_bags(self.out, self.bags)
        self.bags = []

    def _begin(self, out: Path, group: Group) -> None:
        """Open the bags of an episode, which is as long as it will be driven."""
        start = group.state
        for seed in start.seed.tolist():
            folder = episode_folder(out, seed)
            if folder.exists():
                raise ConfigError(
                    f'visited is {str(out)!r}: {folder.name} is there already; choose another '
                    'folder or remove it'
                )
        out.mkdir(parents=True, exist_ok=True)
        self.steps = int(start.step[0]) + group.left
        world = replace(group.config.world, episode_steps=self.steps)
        self.bags = open_bags(out, world, start, self.compression)
        self.episode, self.noise_std = group.episode, group.config.noise_std
        self.before, self.tally = start, start_tally(start)

    def _write(self, state: WorldState, driven: Tensor | None, labels: Tensor | None) -> None:
        """Write a state (B) into the bags, with commands (B, H, 2) m/s unless it is the last."""
        ranges = scan(perceive(state, self.noise_std), self.lidar).numpy()
        values = metrics(self.tally, state, self.steps)
        for k, bag in enumerate(self.bags):
            bag.step(
                state.world(k),
                self.before.world(k),
                ranges[k],
                [] if driven is None else driven[k].tolist(),
                {name: float(values[name][k]) for name in METRICS},
                self.lidar.range_max,
                (LABELS, [] if labels is None else labels[k].tolist()),
            )
