"""Training by PPO in the simulator: the loop, its logs, and resuming."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import time
from typing import Any

from shepherd_ros.config import Config, option, part
from shepherd_ros.learning.annealing import (
    AnnealConfig,
    discount,
    stage_at,
    stages,
)
from shepherd_ros.learning.distributed import ranks, total
from shepherd_ros.learning.ppo import PPOConfig, PPOLearner
from shepherd_ros.learning.ppo_rollout import Rollout
from shepherd_ros.learning.run_folder import RunFolder
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.learning.training_loop import TrainingLoop
from shepherd_ros.learning.validation import EvaluationConfig, validate
from shepherd_ros.policy.network import fast_dtype
from shepherd_ros.policy.policy import Policy
from shepherd_ros.sim.rng import mixed_seeds
import torch


@dataclass(frozen=True)
class PPORunConfig(Config):
    """A whole training run."""

    seed: int = option(0, 'seed of weights, worlds and order', low=0)
    samples: int = option(2_000_000, 'decisions of single shepherds to learn from', low=1)
    groups: int = option(4, 'groups of worlds; those of one share what is drawn', low=1)
    worlds: int = option(36, 'worlds of a group', low=1)
    decisions: int = option(24, 'decisions of each shepherd between updates', low=1)
    critic_warmup: int = option(0, 'updates in which only the critic learns', low=0)
    new_critic: bool = option(False, 'start with a new critic, whatever --pretrained has')
    eval_freq: int = option(10, 'updates from one evaluation to the next', low=1)
    evaluation: EvaluationConfig = part(EvaluationConfig)
    task: TaskConfig = part(TaskConfig)
    anneal: AnnealConfig = part(AnnealConfig)
    ppo: PPOConfig = part(PPOConfig)


class PPOTrainer:
    """The policy, its learner, and the worlds of the present stage."""

    def __init__(self, policy: Policy, config: PPORunConfig) -> None:
        """Start in the first stage."""
        self.policy, self.config, self.eval_freq = policy, config, config.eval_freq
        self.dtype = fast_dtype(policy.device)
        self.stages = stages(policy.config, config.anneal)
        self.learner = PPOLearner(policy, config.ppo)
        self.generator = torch.Generator('cpu').manual_seed(config.seed + 1)
        self.progress = {'samples': 0, 'updates': 0, 'world_steps': 0, 'stage': 0}
        self.enter(0)

    def enter(self, stage: int) -> None:
        """Begin a stage, with new worlds."""
        config = self.config
        self.progress['stage'] = stage
        self.policy = self.learner.policy = self.policy.with_config(self.stages[stage])
        self.rollout = Rollout(
            config.task,
            self.policy,
            config.groups,
            config.worlds,
            config.decisions,
            int(mixed_seeds(1, config.seed, stage)),
            self.dtype,
            critic=self.learner.state_critic(),
            teacher=config.ppo.teacher,
        )

    def share(self) -> float:
        """Return the fraction of the samples that is used."""
        return self.progress['samples'] / self.config.samples

    def averaged(self) -> Policy:
        """Return a policy with the running mean of the actor's weights."""
        return self.learner.averaged()

    def update(self, stopping: Callable[[], bool]) -> dict[str, float]:
        """Collect a batch and train on it; return logged scalars."""
        config = self.config
        fraction = self.share()
        # a run that is given more samples does not go back to stages that it has left
        stage = max(stage_at(fraction, len(self.stages), config.anneal), self.progress['stage'])
        if stage != self.progress['stage']:
            self.enter(stage)
        timing = self.rollout.timing
        repeat = timing.action_repeat
        started = time.monotonic()
        self.learner.scale_learning_rate(1 - fraction)
        gamma = discount(config.ppo.gamma, timing)
        scale = 100 * (1 - gamma) / repeat
        batch, scalars = self.rollout.collect(gamma, config.ppo.gae_lambda, scale)
        collected = time.monotonic()
        acting = self.progress['updates'] >= config.critic_warmup
        scalars |= self.learner.update(self.rollout.store, batch, self.generator, acting)
        self.rollout.roll()
        self.progress['samples'] += int(total(len(batch.value)))
        self.progress['updates'] += 1
        steps = config.groups * config.worlds * config.decisions * repeat
        self.progress['world_steps'] += steps * ranks()
        scalars['rollout_share'] = (collected - started) / (time.monotonic() - started)
        return scalars | {'decision_interval': timing.decision_interval}

    def evaluate(self, policy: Policy) -> dict[str, float]:
        """Return the results of a policy on fixed starts."""
        return validate(policy, self.config.task, self.config.evaluation, self.dtype)

    def state_dict(self) -> dict[str, Any]:
        """Return the state of the training."""
        return {
            'learner': self.learner.state_dict(),
            'rollout': self.rollout.state_dict(),
            'generator': self.generator.get_state(),
            'progress': dict(self.progress),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state that state_dict() returned."""
        self.progress = dict(state['progress'])
        self.enter(int(self.progress['stage']))
        self.learner.load_state_dict(state['learner'])
        self.rollout.load_state_dict(state['rollout'])
        self.generator.set_state(state['generator'].to('cpu'))


def train_ppo(
    policy: Policy,
    config: PPORunConfig,
    run: RunFolder,
    on_line: Callable[[dict[str, Any]], None] = lambda line: None,
) -> Policy:
    """
    Train until the samples are used up; return the policy, whose weights change in place.

    The policy that is evaluated and kept is a running mean of the weights.
    """
    trainer = PPOTrainer(policy, config)
    TrainingLoop(run, trainer, on_line).run_to_end()
    return trainer.policy
