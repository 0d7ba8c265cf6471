"""Behaviour cloning from any number of bags, with one episode in memory at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shepherd_ros.config import Config, ConfigError, option, part
from shepherd_ros.datasets.dataset_report import Report
from shepherd_ros.datasets.examples import driver_names, examples_of, OnBag, stream_steps
from shepherd_ros.datasets.steps import Steps
from shepherd_ros.learning.bag_modes import holding
from shepherd_ros.learning.clone import CloneConfig, CloneLearner, Examples
from shepherd_ros.learning.held_out import ExampleBatch, held_out_results, is_held_out
from shepherd_ros.learning.run_folder import RunFolder
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.learning.training_loop import TrainingLoop
from shepherd_ros.learning.validation import EvaluationConfig, validate
from shepherd_ros.policy.network import fast_dtype
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.observation import rotate_by_ray
from shepherd_ros.sim.rng import mixed_seeds
import torch


@dataclass(frozen=True)
class BCConfig(Config):
    """A whole run; all are choices."""

    seed: int = option(0, 'seed of weights and order', low=0)
    epochs: int = option(5, 'times that all bags are read', low=1)
    buffer_size: int = option(100_000, 'examples that are mixed with each other', low=1)
    replay_ratio: float = option(
        1.0, 'times that an example is learned from in an epoch', low=0.01
    )
    labels: str = option('', 'namespace of the commands to learn; empty: those that were driven')
    drivers: str = option(
        '', 'sources of mux whose steps are learned, such as keys or keys,joy; empty: all',
        sparse=True,
    )  # fmt: skip
    home_within: float = option(
        0.85, 'two modes: the teacher holds with the flock so near the goal [goal radii]', low=0.0,
        sparse=True,
    )  # fmt: skip
    away_beyond: float = option(
        1.8, 'and drives again with it farther than this [goal radii]', low=0.0, sparse=True
    )
    held_out_share: float = option(
        0.0, 'share of the bags that are not learned from, for held_out_error', low=0.0, high=0.5,
        sparse=True,
    )  # fmt: skip
    offline: bool = option(
        False, 'keep the policy with the least held_out_error, and never use the simulator',
        sparse=True,
    )  # fmt: skip
    evaluation: EvaluationConfig = part(EvaluationConfig)
    task: TaskConfig = part(TaskConfig)
    clone: CloneConfig = part(CloneConfig)

    def __post_init__(self) -> None:
        """Check each field, the order of the distances, and that something is evaluated."""
        super().__post_init__()
        if self.home_within > self.away_beyond:
            raise ConfigError(
                f'home_within is {self.home_within}: expected at most away_beyond, '
                f'{self.away_beyond}'
            )
        if self.offline and not self.held_out_share:
            raise ConfigError(
                'held_out_share is 0.0: expected more with offline, such as 0.1, as a policy '
                'is then chosen by bags that it did not learn from'
            )


def require_fit(steps: Steps, config: PolicyConfig) -> None:
    """Raise ConfigError if steps were recorded with another lidar."""
    if steps.range_max and abs(steps.range_max - config.lidar.range_max) > 1e-3:
        raise ConfigError(
            f'{steps.where}: scans have range_max {steps.range_max} m, expected '
            f'{config.lidar.range_max} m'
        )
    if len(steps):
        steps.layout.require(config.lidar.layout, steps.where)


def stream_examples(
    places: Sequence[Path],
    policy: Policy,
    report: Report,
    config: BCConfig,
    seed: int | None = None,
    chosen: Callable[[int], bool] = lambda index: True,
) -> Iterator[ExampleBatch]:
    """
    Yield scaled frames (n, K, C, R), first ray (n,), target (n, 2) m/s and hold (n,) bool.

    They come episode by episode; hold is false for a policy with one mode. Other arguments are
    those of stream_steps().
    """
    drivers = driver_names(config.drivers)
    for _, steps in stream_steps(places, report, seed, config.labels, drivers, chosen):
        require_fit(steps, policy.config)
        examples = examples_of(steps, policy.config.observation, report, drivers)
        if examples is not None:
            frames = examples.frames()
            first = policy.first_ray(frames[:, -1])
            target = rotate_by_ray(examples.wanted, -first, frames.shape[-1])
            hold = torch.zeros(len(examples), dtype=torch.bool)
            if policy.config.network.modes == 2:
                modes = holding(steps, config.home_within, config.away_beyond)
                hold = torch.from_numpy(modes)[examples.chosen]
            yield policy.scale(frames), first, target, hold


class BCTrainer:
    """Training on the examples of bags; an epoch can be interrupted and resumed."""

    eval_freq = 1

    def __init__(self, policy: Policy, places: Sequence[Path], config: BCConfig) -> None:
        """Start with the first epoch."""
        self.policy, self.places, self.config = policy, places, config
        self.dtype = fast_dtype()
        self.examples = Examples(policy, config.buffer_size, self.dtype)
        self.learner = CloneLearner(deepcopy(policy), config.clone, config.seed)
        self.report = Report()
        self.progress = {'updates': 0, 'samples': 0}
        self.episodes_read = 0  # episodes of this epoch
        self.batches_due = 0.0  # batches
        self.losses: list[float] = []
        self.on_bag: OnBag = lambda done, total: None

    def share(self) -> float:
        """Return the fraction of the epochs that is done."""
        return self.progress['updates'] / self.config.epochs

    def averaged(self) -> Policy:
        """Return the policy with the running mean of the weights."""
        return self.learner.averaged(self.policy)

    def update(self, stopping: Callable[[], bool]) -> dict[str, float] | None:
        """Train for the rest of an epoch; return its loss, None if it is interrupted."""
        config, progress = self.config, self.progress
        self.report = Report(on_bag=self.on_bag)
        self.learner.scale_learning_rate(1 - 0.95 * self.share())
        order = int(mixed_seeds(1, config.seed, progress['updates']))
        stream = self._stream(self.report, held_out=False, seed=order)
        for number, (frames, first, target, hold) in enumerate(stream):
            if number < self.episodes_read:
                continue
            self.examples.add(frames, first, target, hold)
            self.batches_due += config.replay_ratio * len(first) / config.clone.batch_size
            while self.batches_due >= 1:
                self.losses.append(self.learner.train_batch(self.examples))
                progress['samples'] += config.clone.batch_size
                self.batches_due -= 1
            self.episodes_read = number + 1
            if stopping():
                return None
        if not self.report.examples:
            raise ConfigError(f'no step of the bags can be learned from:\n{self.report.text()}')
        if not self.losses:  # fewer examples than one batch has
            self.losses.append(self.learner.train_batch(self.examples))
        loss = sum(self.losses) / len(self.losses)
        progress['updates'] += 1
        self.averaged()
        self.episodes_read, self.batches_due, self.losses = 0, 0.0, []
        counts = {name: getattr(self.report, name) for name in ('episodes', 'partial_episodes')}
        return {'loss': loss, **counts}

    def _stream(
        self, report: Report, held_out: bool, seed: int | None = None
    ) -> Iterator[ExampleBatch]:
        """Yield the examples of the bags that are held out, or of the others."""
        config = self.config
        return stream_examples(
            self.places,
            self.policy,
            report,
            config,
            seed,
            lambda index: is_held_out(index, config.held_out_share) == held_out,
        )

    def evaluate(self, policy: Policy) -> dict[str, float]:
        """Return the results of a policy on held-out bags, and in the simulator."""
        config, results = self.config, dict[str, float]()
        if config.held_out_share:
            batches = self._stream(Report(), held_out=True)
            results = held_out_results(policy, batches, config.clone.clip_speed, self.dtype)
            if not results:
                raise ConfigError(
                    f'held_out_share is {config.held_out_share}: expected more, as no step of the '
                    'bags is held out'
                )
        if config.offline:
            return results | {'score': -results['held_out_error']}
        return results | validate(policy, config.task, config.evaluation, self.dtype)

    def state_dict(self) -> dict[str, Any]:
        """Return the state of the training."""
        return {
            'cloner': self.learner.state_dict(),
            'examples': self.examples.state_dict(),
            'progress': dict(self.progress),
            'epoch': (self.episodes_read, self.batches_due, self.losses),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state that state_dict() returned."""
        self.learner.load_state_dict(state['cloner'])
        self.averaged()
        self.examples.load_state_dict(state['examples'])
        self.progress = dict(state['progress'])
        self.episodes_read, self.batches_due, self.losses = state['epoch']


def train_bc(
    policy: Policy,
    places: Sequence[Path],
    config: BCConfig,
    run: RunFolder,
    on_line: Callable[[dict[str, Any]], None] = lambda line: None,
    on_bag: OnBag = lambda done, total: None,
) -> Report:
    """
    Fit a policy to bags or data sets, in place; return the report on them.

    Examples go through a store from which batches are drawn, so that batches mix episodes. The
    policy that is evaluated and kept is a running mean of the weights. Raises ConfigError if the
    bags hold no example.
    """
    trainer = BCTrainer(policy, places, config)
    trainer.on_bag = on_bag
    TrainingLoop(run, trainer, on_line).run_to_end()
    return trainer.report
