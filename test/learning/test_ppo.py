"""The pieces of PPO on numbers worked out by hand, and a problem that it has to solve."""

from __future__ import annotations

import math

import pytest
from shepherd_ros.learning.gae import advantages
from shepherd_ros.learning.ppo import (
    approximate_kl,
    clipped_loss,
    explained_variance,
    PPOConfig,
    PPOLearner,
)
from shepherd_ros.learning.ppo_rollout import log_prob, Rollout
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import ObservationConfig
from shepherd_ros.sim.rollout import Moment
import torch
from torch import Tensor


def column(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float32)[:, None]


def test_advantages_by_hand() -> None:
    # gamma 1/2, lambda 1/2: errors are 1 + 4/2 - 2 = 1, 0 + 8/2 - 4 = 0, 2 + 2/2 - 8 = -5
    result = advantages(
        column(1, 0, 2), column(2, 4, 8), column(4, 8, 2), column(0, 0, 0).bool(), 0.5, 0.5
    )
    assert result[:, 0].tolist() == [1 + (0 - 5 / 4) / 4, -5 / 4, -5]


def test_advantages_do_not_reach_over_an_end_which_is_bootstrapped() -> None:
    reward, value, ended = column(1, 1, 1), column(0, 0, 0), column(0, 1, 0).bool()
    # the last value of the first episode is 6, that of the running one 2
    following = column(0, 6, 2)
    result = advantages(reward, value, following, ended, 0.5, 1.0)
    assert result[:, 0].tolist() == [1 + 0.5 * 4, 1 + 3, 1 + 1]


def test_with_lambda_one_an_advantage_is_the_discounted_return_less_the_value() -> None:
    torch.manual_seed(0)
    reward, value, last = torch.randn(6, 3), torch.randn(6, 3), torch.randn(1, 3)
    following = torch.cat([value[1:], last])
    result = advantages(reward, value, following, torch.zeros(6, 1).bool(), 0.9, 1.0)
    for t in range(6):
        powers = 0.9 ** torch.arange(6 - t)
        returned = (powers[:, None] * reward[t:]).sum(dim=0) + 0.9 ** (6 - t) * last[0]
        torch.testing.assert_close(result[t], returned - value[t], atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(
    ('ratio', 'advantage', 'loss'),
    [(1.0, 2.0, -2.0), (1.5, 2.0, -2.4), (0.5, 2.0, -1.0), (1.5, -2.0, 3.0), (0.5, -2.0, 1.6)],
)
def test_the_clipped_loss_by_hand(ratio: float, advantage: float, loss: float) -> None:
    result = clipped_loss(torch.tensor([ratio]), torch.tensor([advantage]), 0.2)
    assert result.item() == pytest.approx(loss)


def test_the_divergence_of_two_normals_is_estimated() -> None:
    generator = torch.Generator().manual_seed(0)
    mean, std, other = torch.zeros(1, 2), torch.ones(1, 2), torch.tensor([[0.3, 0.0]])
    action = torch.randn(200_000, 2, generator=generator)
    ratio = log_prob(action, other, std) - log_prob(action, mean, std)
    assert float(approximate_kl(ratio)) == pytest.approx(0.3**2 / 2, rel=0.05)
    assert float(approximate_kl(torch.zeros(3))) == 0.0


def test_the_density_of_a_normal_by_hand() -> None:
    result = log_prob(
        torch.tensor([[1.0, 2.0]]), torch.tensor([[0.0, 2.0]]), torch.tensor([[2.0, 0.5]])
    )
    assert result.item() == pytest.approx(-1 / 8 - math.log(2.0) - math.log(0.5))


def test_explained_variance_is_one_for_a_perfect_guess_and_zero_for_the_mean() -> None:
    target = torch.tensor([1.0, 2.0, 6.0])
    assert explained_variance(target, target) == 1.0
    assert explained_variance(torch.full((3,), 3.0), target) == pytest.approx(0.0, abs=1e-6)


def nearness(moment: Moment) -> Tensor:
    """Return a reward that tells each shepherd to go to the goal, (B, H)."""
    state = moment.state
    return -torch.linalg.vector_norm(state.shepherds - state.goal[:, None], dim=-1) / 10


@pytest.mark.system
def test_ppo_learns_to_go_to_the_goal() -> None:
    torch.manual_seed(1)
    policy = Policy(
        PolicyConfig(
            decision_interval=2.0,
            lidar=LidarConfig(n_rays=96),
            observation=ObservationConfig(n_frames=1, frame_interval=2.0, unit=10.0, align='goal'),
            network=NetworkConfig(filters_1=8, filters_2=8, hidden=32),
        )
    )
    task = TaskConfig(sheep_min=1, sheep_max=1, shepherds_min=2, shepherds_max=2, episode_steps=96)
    config = PPOConfig(
        gamma=0.9, minibatch_size=256, actor_learning_rate=1e-3, critic_learning_rate=1e-3
    )
    rollout = Rollout(task, policy, 1, 16, 24, 0, torch.float32, nearness)
    learner, generator = PPOLearner(policy, config), torch.Generator().manual_seed(2)
    rewards = []
    for _ in range(25):
        batch, seen = rollout.collect(config.gamma, config.gae_lambda, 0.25)
        learner.update(rollout.store, batch, generator)
        rollout.roll()
        rewards.append(seen['reward'])
    before, after = sum(rewards[:4]) / 4, sum(rewards[-4:]) / 4
    assert before < -1.0  # ten metres and more away
    assert after > before / 2, (before, after)


def test_the_kept_policy_is_the_running_mean_of_the_weights() -> None:
    torch.manual_seed(3)
    policy = Policy(
        PolicyConfig(
            lidar=LidarConfig(n_rays=96),
            observation=ObservationConfig(n_frames=1),
            network=NetworkConfig(filters_1=2, filters_2=2, hidden=4),
        )
    )
    learner = PPOLearner(policy, PPOConfig(ema_decay=0.75))
    bias = policy.actor.head.bias
    expected = torch.zeros(4)
    for k in range(3):
        with torch.no_grad():
            bias += torch.arange(4.0)
        learner.average.update_parameters(policy.actor)
        # the first value is taken over whole
        expected = bias.clone() if k == 0 else 0.75 * expected + 0.25 * bias
    stored = learner.averaged()
    torch.testing.assert_close(stored.actor.head.bias, expected)
    assert bias.tolist() == [0, 3, 6, 9]  # learning itself goes on from the newest
    for name, value in policy.critic.state_dict().items():
        assert value.equal(stored.critic.state_dict()[name])
