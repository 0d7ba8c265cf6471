"""A judgement is the mean over flock models and sizes."""

from __future__ import annotations

from dataclasses import replace

import pytest
from shepherd_ros.config import ConfigError
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


def test_sizes_teams_and_ways_of_acting_are_cells_of_their_own() -> None:
    torch.manual_seed(0)
    network = NetworkConfig(filters_1=2, filters_2=2, hidden=4)
    policy = Policy(PolicyConfig(lidar=LidarConfig(n_rays=64), network=network))
    task = TaskConfig(shepherds_min=1, shepherds_max=4)
    usual = {'eval_steps': 5, 'eval_sample_std': 0.6}
    evaluation = EvaluationConfig(24, eval_sheep='4,9', eval_shepherds='1, 3', **usual)
    whole = validate(policy, task, evaluation, torch.float32)
    parts = [
        validate(
            policy, replace(task, sheep_min=n, sheep_max=n, shepherds_min=m, shepherds_max=m),
            EvaluationConfig(6, **usual), torch.float32,
        )
        for n in (4, 9)
        for m in (1, 3)
    ]  # fmt: skip
    assert len({part['return'] for part in parts}) == 4
    for name in ('return', 'shepherd_path_length', 'fraction_in_goal'):
        assert whole[name] == pytest.approx(sum(part[name] for part in parts) / 4, rel=1e-5)
    means = replace(evaluation, eval_episodes=12, eval_sample_std=0.0)
    paths = [validate(policy, task, e, torch.float32) for e in (evaluation, means)]
    assert paths[0]['shepherd_path_length'] > 1.5 * paths[1]['shepherd_path_length']


def test_the_score_by_hand() -> None:
    results = {
        'return': 5.0, 'fraction_in_goal': 0.8, 'completion_time_95': 250.0,
        'shepherd_path_length': 130.0,
    }  # fmt: skip
    assert EvaluationConfig().score(results) == 5.0 / 10 + 0.8
    weighted = EvaluationConfig(
        eval_steps=500, return_weight=0.0, goal_weight=2.0, time_weight=3.0, path_weight=0.5
    )
    assert weighted.score(results) == pytest.approx(2 * 0.8 - 3 * 0.5 - 0.5 * 1.3)


def test_an_episode_that_never_completes_counts_as_long_as_it_is() -> None:
    network = NetworkConfig(filters_1=2, filters_2=2, hidden=4)
    policy = Policy(PolicyConfig(lidar=LidarConfig(n_rays=64), network=network))
    task = TaskConfig(sheep_min=4, sheep_max=4)
    results = validate(policy, task, EvaluationConfig(4, eval_steps=7), torch.float32)
    assert results['completed'] == 0
    assert results['completion_time_95'] == 7


@pytest.mark.parametrize('text', ['0', '1,-3', '2;3', 'all', '1.5'])
def test_sizes_that_are_no_numbers_are_refused(text: str) -> None:
    for name in ('eval_sheep', 'eval_shepherds'):
        with pytest.raises(ConfigError, match=f"{name} is '{text}': expected numbers from 1"):
            EvaluationConfig(**{name: text})


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
