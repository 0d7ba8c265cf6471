"""Train by PPO in the simulator: the loop, its record, and going on after an interruption."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import time
from typing import Any

from shepherd_ros.config import Config, option, part
from shepherd_ros.learning.judge import judge
from shepherd_ros.learning.ppo import Learner, PPOConfig
from shepherd_ros.learning.rollout import Rollout
from shepherd_ros.learning.run_folder import Run
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.policy.checkpoint import save_policy
from shepherd_ros.policy.network import fast_dtype
from shepherd_ros.policy.policy import Policy
import torch


@dataclass(frozen=True)
class PPORunConfig(Config):
    """A whole training run."""

    seed: int = option(0, 'seed of weights, worlds and order', low=0)
    samples: int = option(2_000_000, 'decisions of single shepherds to learn from', low=1)
    groups: int = option(4, 'groups of worlds; those of one share what is drawn', low=1)
    worlds: int = option(18, 'worlds of a group', low=1)
    decisions: int = option(48, 'decisions of each shepherd between updates', low=1)
    critic_first: int = option(0, 'updates in which only the critic learns', low=0)
    judge_every: int = option(10, 'updates from one evaluation to the next', low=1)
    judge_episodes: int = option(32, 'episodes of an evaluation', low=2)
    judge_steps: int = option(1000, 'steps of these episodes', low=1)
    task: TaskConfig = part(TaskConfig)
    ppo: PPOConfig = part(PPOConfig)


def train_ppo(
    policy: Policy,
    config: PPORunConfig,
    run: Run,
    on_line: Callable[[dict[str, Any]], None] = lambda line: None,
) -> Policy:
    """
    Learn until the samples are used up; return the policy, which is changed in place.

    The run's folder holds the state after each evaluation, and training goes on from there with
    the same numbers as if it had not been interrupted. The best checkpoint is beside it.
    """
    dtype = fast_dtype()
    learner = Learner(policy, config.ppo)
    generator = torch.Generator().manual_seed(config.seed + 1)
    rollout = Rollout(
        config.task, policy, config.groups, config.worlds, config.decisions, config.seed, dtype
    )
    parts: dict[str, Learner | Rollout] = {'learner': learner, 'rollout': rollout}
    progress = {'samples': 0, 'updates': 0, 'seconds': 0.0, 'best': -1e9, 'world_steps': 0}
    kept = run.load()
    if kept is not None:
        for name, holder in parts.items():
            holder.load_state_dict(kept[name])
        generator.set_state(kept['generator'])
        progress = kept['progress']
    scale = 100 * (1 - config.ppo.gamma) / policy.config.repeat
    while progress['samples'] < config.samples:
        begun = time.monotonic()
        learner.slow_down(1 - progress['samples'] / config.samples)
        batch, seen = rollout.collect(config.ppo.gamma, config.ppo.decay, scale)
        collected = time.monotonic()
        acting = progress['updates'] >= config.critic_first
        seen |= learner.update(rollout, batch, generator, acting)
        rollout.roll()
        progress['samples'] += len(batch.value)
        progress['updates'] += 1
        progress['world_steps'] += (
            config.groups * config.worlds * config.decisions * policy.config.repeat
        )
        seen['rollout_share'] = (collected - begun) / (time.monotonic() - begun)
        last = progress['samples'] >= config.samples
        judged = {}
        if progress['updates'] % config.judge_every == 0 or last:
            judged = judge(policy, config.task, config.judge_episodes, config.judge_steps, dtype)
        progress['seconds'] += time.monotonic() - begun
        rate = progress['samples'] / progress['seconds']
        line = {
            **progress,
            'samples_per_second': rate,
            'seconds_left': (config.samples - progress['samples']) / rate,
            **seen,
            **{f'judge/{name}': value for name, value in judged.items()},
        }
        if judged:
            if judged['score'] > progress['best']:
                progress['best'] = judged['score']
                record = run.record | {'progress': dict(progress), 'judged': judged}
                save_policy(run.best, policy, record)
            states = {name: holder.state_dict() for name, holder in parts.items()}
            run.save({**states, 'generator': generator.get_state(), 'progress': dict(progress)})
        run.write(line)
        on_line(line)
    return policy
