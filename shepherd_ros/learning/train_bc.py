"""Behaviour cloning from bags: any number of them, of which one episode is in memory at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
import time
from typing import Any

from shepherd_ros.config import Config, ConfigError, option, part
from shepherd_ros.datasets.dataset_report import Report
from shepherd_ros.datasets.examples import examples_of, stream_steps
from shepherd_ros.datasets.steps import Steps
from shepherd_ros.learning.clone import CloneConfig, CloneLearner, Examples
from shepherd_ros.learning.run_folder import RunFolder
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.learning.validation import validate
from shepherd_ros.policy.network import fast_dtype
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.observation import turned
from shepherd_ros.sim.rng import mixed_seeds
from torch import Tensor


@dataclass(frozen=True)
class BCConfig(Config):
    """A whole run; all are choices."""

    seed: int = option(0, 'seed of weights and order', low=0)
    epochs: int = option(5, 'times that all bags are read', low=1)
    buffer_size: int = option(100_000, 'examples that are mixed with each other', low=1)
    replay_ratio: float = option(
        1.0, 'times that an example is learned from in an epoch', low=0.01
    )
    eval_episodes: int = option(32, 'episodes of the evaluation after an epoch', low=2)
    eval_steps: int = option(1000, 'steps of these episodes', low=1)
    labels: str = option('', 'namespace of the commands to learn; empty: those that were driven')
    task: TaskConfig = part(TaskConfig)
    clone: CloneConfig = part(CloneConfig)


def require_fit(steps: Steps, config: PolicyConfig) -> None:
    """Raise ConfigError if steps were recorded with another time step or lidar."""
    if steps.dt != config.dt:
        raise ConfigError(f'{steps.where}: dt is {steps.dt} s, expected {config.dt} s')
    if len(steps):
        steps.layout.require(config.lidar.layout, steps.where)


def stream_examples(
    places: Sequence[Path],
    policy: Policy,
    report: Report,
    seed: int | None = None,
    labels: str = '',
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """
    Yield scaled frames (n, K, C, R), ray in front (n,), wanted action (n, 2) episode by episode.

    Arguments are those of stream_steps().
    """
    for _, steps in stream_steps(places, report, seed, labels):
        require_fit(steps, policy.config)
        found = examples_of(steps, policy.config.observation, report)
        if found is not None:
            frames = found.frames()
            first = policy.first_ray(frames[:, -1])
            wanted = turned(found.wanted, -first, frames.shape[-1])
            yield policy.scaled(frames), first, wanted


def train_bc(
    policy: Policy,
    places: Sequence[Path],
    config: BCConfig,
    run: RunFolder,
    on_line: Callable[[dict[str, Any]], None] = lambda line: None,
) -> Report:
    """
    Fit a policy to bags or data sets, in place; return the report on them.

    Examples go through a store from which batches are drawn, so that neighbours in time are
    learned apart. What is judged and kept is a running mean of the weights. Raises ConfigError
    if the bags hold no example.
    """
    dtype = fast_dtype()
    examples = Examples(policy, config.buffer_size, dtype)
    cloner = CloneLearner(deepcopy(policy), config.clone, config.seed)
    begun, learned = time.monotonic(), 0
    report = Report()
    for epoch in range(config.epochs):
        report = Report()
        cloner.slow_down(1 - 0.95 * epoch / config.epochs)
        losses: list[float] = []
        due = 0.0
        order = int(mixed_seeds(1, config.seed, epoch))
        for frames, first, wanted in stream_examples(places, policy, report, order, config.labels):
            examples.add(frames, first, wanted)
            due += config.replay_ratio * len(first) / config.clone.batch_size
            while due >= 1:
                losses.append(cloner.take_step(examples))
                learned, due = learned + config.clone.batch_size, due - 1
        if not report.examples:
            raise ConfigError(f'no step of the bags can be learned from:\n{report.text()}')
        if not losses:  # fewer examples than one batch has
            losses.append(cloner.take_step(examples))
        cloner.averaged(policy)
        results = validate(policy, config.task, config.eval_episodes, config.eval_steps, dtype)
        seconds = time.monotonic() - begun
        line: dict[str, Any] = {
            'updates': epoch + 1,
            'samples': learned,
            'seconds': seconds,
            'seconds_left': seconds / (epoch + 1) * (config.epochs - epoch - 1),
            'loss': sum(losses) / len(losses),
        }
        line |= run.keep_best(policy, results, line)
        run.write(line)
        on_line(line)
    return report
