"""Behaviour cloning from any number of bags, with one episode in memory at a time."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shepherd_ros.config import Config, ConfigError, option, part
from shepherd_ros.datasets.dataset_report import Report
from shepherd_ros.datasets.examples import driver_names, examples_of, OnBag, stream_steps
from shepherd_ros.datasets.steps import Steps
from shepherd_ros.learning.clone import CloneConfig, CloneLearner, Examples
from shepherd_ros.learning.run_folder import RunFolder
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.learning.training_loop import TrainingLoop
from shepherd_ros.learning.validation import EvaluationConfig
from shepherd_ros.policy.network import fast_dtype
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.observation import rotate_by_ray
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
    labels: str = option('', 'namespace of the commands to learn; empty: those that were driven')
    drivers: str = option(
        '', 'sources of mux whose steps are learned, such as keys or keys,joy; empty: all',
        sparse=True,
    )  # fmt: skip
    evaluation: EvaluationConfig = part(EvaluationConfig)
    task: TaskConfig = part(TaskConfig)
    clone: CloneConfig = part(CloneConfig)


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
    seed: int | None = None,
    labels: str = '',
    drivers: Collection[str] = (),
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """
    Yield scaled frames (n, K, C, R), first ray (n,) and target (n, 2) m/s, episode by episode.

    Arguments are those of stream_steps().
    """
    for _, steps in stream_steps(places, report, seed, labels, drivers):
        require_fit(steps, policy.config)
        examples = examples_of(steps, policy.config.observation, report, drivers)
        if examples is not None:
            frames = examples.frames()
            first = policy.first_ray(frames[:, -1])
            target = rotate_by_ray(examples.wanted, -first, frames.shape[-1])
            yield policy.scale(frames), first, target


class BCTrainer:
    """Training on the examples of bags; an epoch can be interrupted and resumed."""

    eval_freq = 1

    def __init__(self, policy: Policy, places: Sequence[Path], config: BCConfig) -> None:
        """Start with the first epoch; ConfigError for a policy with two modes."""
        if policy.config.network.modes > 1:
            raise ConfigError(
                f'modes is {policy.config.network.modes}: expected 1 to learn from bags, whose '
                'commands do not say whether they drive or hold; train dagger teaches both'
            )
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
        drivers = driver_names(config.drivers)
        stream = stream_examples(
            self.places, self.policy, self.report, order, config.labels, drivers
        )
        for number, (frames, first, target) in enumerate(stream):
            if number < self.episodes_read:
                continue
            self.examples.add(frames, first, target)
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
