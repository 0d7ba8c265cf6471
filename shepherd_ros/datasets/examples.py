"""Recordings as examples: the frames of each shepherd and its command."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
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

OnBag = Callable[[int, int], None]  # how many bags are done, of how many


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
    chosen: Tensor  # (m,) int64: the step of each among the steps of the episode

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


def driver_names(text: str) -> frozenset[str]:
    """Return the sources of mux in a text such as keys, or keys,joy."""
    return frozenset(text.replace(',', ' ').split())


def sources(
    places: Sequence[Path], labels: str = '', drivers: Collection[str] = ()
) -> list[Source]:
    """
    Return the bags at places, which are bags, folders of bags or data sets.

    labels is the namespace of the commands to learn, empty for the executed ones; drivers are the
    sources of mux whose commands are learned, all if none is named. Raises ConfigError for other
    places, and for data sets with other labels or drivers.
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
        if dataset.drivers and dataset.drivers != frozenset(drivers):
            names = ','.join(sorted(dataset.drivers))
            raise ConfigError(
                f'{place}: it was built with --drivers {names}, expected '
                f'{",".join(sorted(drivers)) or "all"}; give --drivers {names}, or build another'
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
    places: Sequence[Path],
    report: Report,
    seed: int | None = None,
    labels: str = '',
    drivers: Collection[str] = (),
    chosen: Callable[[int], bool] = lambda index: True,
) -> Iterator[tuple[Source, Steps]]:
    """
    Yield the complete steps of each episode and their source; raises ConfigError.

    One episode is in memory at a time; with a seed, bags come in random order. chosen(index) says
    which bags are read, by their place in the order of their names.
    """
    shuffled = [s for k, s in enumerate(sources(places, labels, drivers)) if chosen(k)]
    if seed is not None:
        random.Random(seed).shuffle(shuffled)
    for source in shuffled:
        report.on_bag(report.bags, len(shuffled))
        report.bags += 1
        for steps in source.read(report.refuse):
            report.count_episode(steps)
            yield source, steps


def examples_of(
    steps: Steps, observation: ObservationConfig, report: Report, drivers: Collection[str] = ()
) -> EpisodeExamples | None:
    """
    Return the examples of an episode, None if there are none.

    Frames go back to the episode's first state and no farther, as in the environment. An example
    with an earlier frame of an incomplete step is dropped and counted, as are steps with other
    drivers; the frames of those are seen in later examples.
    """
    team = steps.n_shepherds
    step = torch.from_numpy(steps.step)
    frame = observation.frames(steps.dt).rows(step, torch.zeros_like(step)).numpy()
    key = steps.step * team + steps.shepherd  # in order
    frame_keys = frame * team + steps.shepherd[:, None]
    rows = np.minimum(np.searchsorted(key, frame_keys), max(len(key) - 1, 0))
    complete = (key[rows] == frame_keys).all(axis=1) if len(key) else np.zeros(0, bool)
    chosen = steps.driven_by(drivers)
    for reason, dropped in (
        ('another driver', ~chosen),
        ('an earlier frame is missing', chosen & ~complete),
    ):
        if dropped.any():
            k = int(np.argmax(dropped))
            place = f'{steps.where}, step {steps.step[k]}, shepherd_{steps.shepherd[k]}'
            report.drop(reason, place, int(dropped.sum()))
    complete &= chosen
    if not complete.any():
        return None
    report.examples += int(complete.sum())
    return EpisodeExamples(
        torch.from_numpy(steps.lidar),
        torch.from_numpy(rows[complete]),
        torch.from_numpy(steps.action[complete]),
        torch.from_numpy(np.flatnonzero(complete)),
    )


def count_examples(
    places: Sequence[Path],
    observation: ObservationConfig,
    labels: str = '',
    drivers: Collection[str] = (),
    on_bag: OnBag = lambda done, total: None,
) -> Report:
    """Return the report on places, with the number of examples of this observation."""
    report = Report(on_bag=on_bag)
    for _, steps in stream_steps(places, report, labels=labels, drivers=drivers):
        examples_of(steps, observation, report, drivers)
    return report


def build_dataset(
    places: Sequence[Path],
    folder: Path,
    observation: ObservationConfig,
    labels: str = '',
    drivers: Collection[str] = (),
    on_bag: OnBag = lambda done, total: None,
) -> Report:
    """
    Write the complete steps at places as a data set into a new folder; return the report.

    The data set serves any observation; the report counts the examples of this one. With drivers
    it has all steps of each shepherd that has one of theirs in an episode, as examples see earlier
    frames, too. Raises ConfigError, and leaves no folder then.
    """
    report, source = Report(on_bag=on_bag), None
    with DatasetWriter(folder, labels, drivers=drivers) as writer:
        for current, steps in stream_steps(places, report, labels=labels, drivers=drivers):
            if current is not source:
                writer.begin_bag(current.name)
                source = current
            writer.add(steps.with_context(drivers) if drivers else steps)
            examples_of(steps, observation, report, drivers)
        if not writer.rows:
            raise ConfigError(f'no step of the bags can be learned from:\n{report.text()}')
        writer.close(report.to_dict())
    return report
