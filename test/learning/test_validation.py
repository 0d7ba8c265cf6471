"""A judgement is the mean over flock models and sizes."""

from __future__ import annotations

from dataclasses import replace

import pytest
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.learning.validation import EvaluationConfig, validate, validation_sizes
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.lidar import LidarConfig
import torch


def test_a_judgement_over_both_flocks_and_three_sizes_is_the_mean_of_the_six() -> None:
    torch.manual_seed(0)
    network = NetworkConfig(filters_1=2, filters_2=2, hidden=4)
    policy = Policy(PolicyConfig(lidar=LidarConfig(n_rays=64), network=network))
    task = TaskConfig(flock='both', sheep_min=4, sheep_max=25, sheep_scale='log')
    noisy = EvaluationConfig(eval_episodes=24, eval_steps=5, eval_noise=1.5)
    whole = validate(policy, task, noisy, torch.float32)
    parts = [
        validate(
            policy,
            replace(task, flock=flock, sheep_scale='linear', sheep_min=n, sheep_max=n),
            EvaluationConfig(eval_episodes=4, eval_steps=5, eval_noise=1.5), torch.float32,
        )
        for flock in ('strombom', 'reynolds')
        for n in (4, 10, 25)
    ]  # fmt: skip
    for name, value in whole.items():
        assert value == pytest.approx(sum(part[name] for part in parts) / 6, rel=1e-5), name
    assert len({part['return'] for part in parts}) == 6
    quiet = replace(noisy, eval_episodes=12, eval_noise=0.0)
    assert validate(policy, task, quiet, torch.float32)['return'] != whole['return']


@pytest.mark.parametrize(
    ('low', 'high', 'scale', 'sizes'),
    [
        (10, 200, 'linear', [105]),
        (10, 200, 'log', [10, 45, 200]),
        (100, 100, 'linear', [100]),
        (100, 100, 'log', [100]),
    ],
)
def test_sizes_of_flocks_that_are_judged(
    low: int, high: int, scale: str, sizes: list[int]
) -> None:
    assert validation_sizes(TaskConfig(sheep_min=low, sheep_max=high, sheep_scale=scale)) == sizes
