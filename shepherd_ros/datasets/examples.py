"""Recordings as examples: the frames of each shepherd and its command."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
import random

import numpy as np
from shepherd_ros.config import ConfigError
from shepherd_ros.datasets.dataset_report import Report
from shepherd_ros.datasets.lerobot_reader import Dataset, is_dataset, open_dataset
from shepherd_ros.datasets.lerobot_writer import DatasetWriter
from shepherd_ros.datasets.steps import Refuse, Steps, steps_of
from shepherd_ros.recordings.episodes import iter_episodes
from shepherd_ros.rosbag2.reader import bags_in, open_bag
from shepherd_ros.sim.observation import ObservationConfig
import torch
from torch import Tensor


@dataclass(frozen=True)
class Source:
    """A bag, or the part of a data set that was built from it."""

    name: str
    read: Callable[[Refuse], Iterator[Steps]]  # one episode in memory at a time


@dataclass(frozen=True)
class EpisodeExamples:
    """The examples of one episode; frames are kept once."""

    lidar: Tensor  # (n, C, R) m, +inf on free rays
    rows: Tensor  # (m, K) int64: the frames of each example, oldest first
    wanted: Tensor  # (m, 2) m/s, world frame

    def __len__(self) -> int:
        """Return the number of examples."""
        return len(self.rows)

    def frames(self) -> Tensor:
        """Return the stacks of all examples, (m, K, C, R) m."""
        return self.lidar[self.rows]


def bag_folders(place: Path) -> list[Path]:
    """Return the bags at a place, a bag itself or a folder of bags; raises ConfigError."""
    bags = bags_in(place)
    if not bags:
        raise ConfigError(
            f'{place}: expected a bag, a folder of bags, as shepherd record writes, or a data '
            'set, as shepherd dataset build writes'
        )
    return bags


def sources(places: Sequence[Path], labels: str = '') -> list[Source]:
    """
    Return the bags at places, which are bags, folders of bags or data sets.

    labels is the namespace of the commands to learn, empty for the executed ones. Raises
    ConfigError for other places, and for data sets with other labels.
    """
    result = []
    for place in places:
        if not is_dataset(place):
            bags = bag_folders(place)
            result += [Source(path.name, partial(bag_steps, path, labels)) for path in bags]
            continue
        dataset = open_dataset(place)
        if dataset.labels != labels:
            raise ConfigError(
                f'{place}: its labels are {dataset.labels!r:.60}, expected {labels!r}; give '
                f'--labels {dataset.labels!r:.60}, or build it with --labels {labels!r}'
            )
        for name, part in dataset.bags():
            result.append(Source(name, partial(dataset_steps, dataset, part)))
    return result


def bag_steps(path: Path, labels: str, refuse: Refuse) -> Iterator[Steps]:
    """Yield the complete steps of each episode of a bag; raises ConfigError."""
    for number, episode in enumerate(iter_episodes(open_bag(path), labels=labels)):
        yield steps_of(episode, path.name, number, refuse)


def dataset_steps(dataset: Dataset, part: slice, refuse: Refuse) -> Iterator[Steps]:
    """Yield the steps of each episode among some runs of a data set, which are all complete."""
    return dataset.steps(part)


def stream_steps(
    places: Sequence[Path], report: Report, seed: int | None = None, labels: str = ''
) -> Iterator[tuple[Source, Steps]]:
    """
    Yield the complete steps of each episode and their source; raises ConfigError.

    One episode is in memory at a time; with a seed, bags come in random order.
    """
    shuffled = sources(places, labels)
    if seed is not None:
        random.Random(seed).shuffle(shuffled)
    for source in shuffled:
        report.bags += 1
        for steps in source.read(report.refuse):
            report.count_episode(steps)
            yield source, steps


def examples_of(
    steps: Steps, observation: ObservationConfig, report: Report
) -> EpisodeExamples | None:
    """
    Return the examples of an episode, None if there are none.

    Frames go back to the episode's first state and no farther, as in the environment. An example
    with an earlier frame of an incomplete step is dropped and counted.
    """
    team = steps.n_shepherds
    step = torch.from_numpy(steps.step)
    frame = observation.frames.rows(step, torch.zeros_like(step)).numpy()
    key = steps.step * team + steps.shepherd  # in order
    frame_keys = frame * team + steps.shepherd[:, None]
    rows = np.minimum(np.searchsorted(key, frame_keys), max(len(key) - 1, 0))
    complete = (key[rows] == frame_keys).all(axis=1) if len(key) else np.zeros(0, bool)
    if not complete.all():
        k = int(np.argmin(complete))
        place = f'{steps.where}, step {steps.step[k]}, shepherd_{steps.shepherd[k]}'
        report.drop('an earlier frame is missing', place, int((~complete).sum()))
    if not complete.any():
        return None
    report.examples += int(complete.sum())
    return EpisodeExamples(
        torch.from_numpy(steps.lidar),
        torch.from_numpy(rows[complete]),
        torch.from_numpy(steps.action[complete]),
    )


def count_examples(
    places: Sequence[Path], observation: ObservationConfig, labels: str = ''
) -> Report:
    """Return the report on places, with the number of examples of this observation."""
    report = Report()
    for _, steps in stream_steps(places, report, labels=labels):
        examples_of(steps, observation, report)
    return report


def build_dataset(
    places: Sequence[Path], folder: Path, observation: ObservationConfig, labels: str = ''
) -> Report:
    """
    Write the complete steps at places as a data set into a new folder; return the report.

    The data set serves any observation; the report counts the examples of this one. Raises
    ConfigError, and leaves no folder then.
    """
    report, source = Report(), None
    with DatasetWriter(folder, labels) as writer:
        for current, steps in stream_steps(places, report, labels=labels):
            if current is not source:
                writer.begin_bag(current.name)
                source = current
            writer.add(steps)
            examples_of(steps, observation, report)
        if not writer.rows:
            raise ConfigError(f'no step of the bags can be learned from:\n{report.text()}')
        writer.close(report.to_dict())
    return report
