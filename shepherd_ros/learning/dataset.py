"""Bags as examples: what each shepherd saw, and what it was told to do."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
import random

import numpy as np
from shepherd_ros.bags.episodes import Episode, iter_episodes
from shepherd_ros.bags.metadata import FILE
from shepherd_ros.bags.reader import open_bag
from shepherd_ros.config import ConfigError
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.observation import turned
import torch
from torch import Tensor


@dataclass
class Report:
    """What was found in bags, counted while they are read."""

    bags: int = 0
    episodes: int = 0
    steps: int = 0  # of single shepherds
    examples: int = 0
    drops: Counter[str] = field(default_factory=Counter)  # reason -> steps
    first_drop: dict[str, str] = field(default_factory=dict)  # reason -> where
    speed: float = 0.0  # sum of the speeds [m/s]

    def drop(self, reason: str, where: str) -> None:
        """Count a step that is no example."""
        self.drops[reason] += 1
        self.first_drop.setdefault(reason, where)

    def text(self) -> str:
        """Return the report in lines."""
        lines = [
            f'bags:      {self.bags}',
            f'episodes:  {self.episodes}',
            f'steps:     {self.steps} (of single shepherds)',
            f'examples:  {self.examples}',
            f'speed:     {self.speed / max(self.examples, 1):.3f} m/s in the mean',
        ]
        lines += [
            f'dropped:   {count} steps, {reason}; first: {self.first_drop[reason]}'
            for reason, count in self.drops.most_common()
        ]
        return '\n'.join(lines)


@dataclass(frozen=True)
class EpisodeExamples:
    """The examples of one episode; frames are kept once."""

    readings: Tensor  # (T, H, 3, R) m, +inf on free rays
    at: Tensor  # (n, 2) int64: row of the newest frame, shepherd
    rows: Tensor  # (n, K) int64: rows of the frames, oldest first
    wanted: Tensor  # (n, 2) m/s, world frame

    def __len__(self) -> int:
        """Return how many examples there are."""
        return len(self.at)

    def frames(self) -> Tensor:
        """Return the stacks of all examples, (n, K, 3, R) m."""
        return self.readings[self.rows, self.at[:, 1:]]


def bag_folders(places: Sequence[Path]) -> list[Path]:
    """Return the bags at places: bags themselves, or folders of bags; raises ConfigError."""
    found = []
    for place in places:
        if place.suffix == '.mcap' or (place / FILE).exists():
            found.append(place)
            continue
        inside = sorted(path.parent for path in place.glob(f'*/{FILE}'))
        if not inside:
            raise ConfigError(
                f'{place}: expected a bag or a folder of bags, as shepherd record writes'
            )
        found += inside
    return found


def episode_examples(
    episode: Episode, config: PolicyConfig, report: Report, where: str
) -> EpisodeExamples | None:
    """
    Return the examples of an episode, None if there are none.

    Frames go back to the episode's first state and no farther, as in the environment. A step
    whose command, scan or an earlier frame is missing is dropped and counted. Raises ConfigError
    if the episode was recorded with another time step or lidar.
    """
    if episode.dt != config.dt:
        raise ConfigError(f'{where}: dt is {episode.dt} s, expected {config.dt} s')
    n_rays, team = config.lidar.n_rays, episode.n_shepherds
    steps = np.array([frame.step for frame in episode.frames])
    row_of = {int(step): row for row, step in enumerate(steps)}
    readings = np.full((len(steps), team, 3, n_rays), np.inf, np.float32)
    there = np.zeros((len(steps), team), bool)
    for row, frame in enumerate(episode.frames):
        for h, scan in enumerate(frame.scans):
            if scan is not None:
                if scan.shape[-1] != n_rays:
                    raise ConfigError(
                        f'{where}: scans have {scan.shape[-1]} rays, expected {n_rays}'
                    )
                readings[row, h], there[row, h] = scan, not np.isnan(scan).any()
    observation = config.observation
    back = [k * observation.spacing for k in reversed(range(observation.n_frames))]
    at, rows, wanted = [], [], []
    for row, frame in enumerate(episode.frames[:-1]):  # nothing follows on the last state
        for h in range(team):
            place = f'{where}, step {frame.step}, shepherd_{h}'
            report.steps += 1
            command = frame.commands[h]
            stack = [row_of.get(max(frame.step - ago, 0)) for ago in back]
            if command is None or not np.isfinite(command).all():
                report.drop('no command', place)
            elif not all(known is not None and there[known, h] for known in stack):
                report.drop('a scan is missing', place)
            else:
                at.append((row, h))
                rows.append([known for known in stack if known is not None])
                wanted.append(command)
    if not at:
        return None
    actions = torch.from_numpy(np.array(wanted, np.float32))
    report.examples += len(at)
    report.speed += float(actions.norm(dim=-1).sum())
    return EpisodeExamples(
        torch.from_numpy(readings), torch.tensor(at), torch.tensor(rows), actions
    )


def stream_examples(
    places: Sequence[Path], policy: Policy, report: Report, seed: int | None = None
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """
    Yield scaled frames (n, K, 3, R), ray in front (n,), wanted action (n, 2) episode by episode.

    One episode is in memory at a time; with a seed, bags come in random order.
    """
    bags = bag_folders(places)
    if seed is not None:
        random.Random(seed).shuffle(bags)
    for path in bags:
        report.bags += 1
        for number, episode in enumerate(iter_episodes(open_bag(path))):
            report.episodes += 1
            found = episode_examples(episode, policy.config, report, f'{path.name}:{number}')
            if found is not None:
                frames = found.frames()
                first = policy.first_ray(frames[:, -1])
                wanted = turned(found.wanted, -first, frames.shape[-1])
                yield policy.scaled(frames), first, wanted
