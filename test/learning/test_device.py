"""PPO makes every tensor where its policy is, so that it can all be on a GPU."""

from __future__ import annotations

import pytest
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.learning.train_ppo import PPORunConfig, PPOTrainer
from shepherd_ros.learning.validation import EvaluationConfig, validate
from shepherd_ros.policy import fast_conv
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim import compiled
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import ObservationConfig
import torch


@pytest.mark.parametrize('flock', ['strombom', 'reynolds'])
def test_nothing_is_made_on_the_default_device(
    flock: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # compiled forms are for the CPU alone; a GPU takes the plain ones
    monkeypatch.setattr(compiled, 'HAS_NUMBA', False)
    monkeypatch.setattr(fast_conv, 'HAS_NUMBA', False)
    policy = Policy(
        PolicyConfig(
            decision_interval=1.0,
            lidar=LidarConfig(n_rays=64),
            observation=ObservationConfig(frame_interval=2.0, align='goal'),
            network=NetworkConfig(filters_1=2, filters_2=2, hidden=4),
        )
    )
    task = TaskConfig(
        flock=flock, sheep_min=4, sheep_max=6, shepherds_max=2, episode_steps=4, noise_max=0.5
    )
    config = PPORunConfig(samples=500, groups=2, worlds=2, decisions=3, task=task)
    training = PPOTrainer(policy, config)
    training.update(bool)  # optimisers make their first tensors, which they move by themselves
    before = training.progress['stage']
    # a tensor of this device has no numbers and mixes with none of the CPU
    with torch.device('meta'):
        while training.progress['stage'] == before:
            training.update(bool)
        averaged = training.learner.averaged()
        results = validate(
            averaged, task, EvaluationConfig(eval_episodes=2, eval_steps=3), torch.float32
        )
    assert results['score'] == results['score'], 'no NaN'
    assert all(p.device.type == 'cpu' for p in averaged.parameters())
