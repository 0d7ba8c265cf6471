"""Options of PPO: the critic on the true state, labels at home, parts of a batch, a new critic."""

from __future__ import annotations

from dataclasses import replace
import math

import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.controllers import make_controller
from shepherd_ros.learning.group import team_reward, WorldGroup
from shepherd_ros.learning.home_labels import HomeLabels
from shepherd_ros.learning.ppo import label_loss, PPOConfig, PPOLearner
from shepherd_ros.learning.ppo_rollout import Batch, Rollout
from shepherd_ros.learning.state_critic import FEATURES, state_features, StateCritic
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.policy.warm_start import warm_start
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import rotate_by_ray
from shepherd_ros.sim.rollout import EnvConfig, Moment, start
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.world import SpawnConfig, WorldConfig
import torch
from torch import Tensor

CONFIG = PolicyConfig(
    lidar=LidarConfig(n_rays=96), network=NetworkConfig(filters_1=4, filters_2=4, hidden=16)
)
TASK = TaskConfig(sheep_min=6, sheep_max=6, shepherds_max=3, episode_steps=40)


def policy_of(config: PolicyConfig = CONFIG) -> Policy:
    torch.manual_seed(5)
    return Policy(config)


def moment_of() -> Moment:
    """Return worlds with teams of 1 to 4 shepherds, the flock near the goal."""
    near = SpawnConfig(flock_distance_min=1.0, flock_distance_max=8.0, fewest_shepherds=1)
    world = WorldConfig(n_sheep=12, n_shepherds=4, spawn=near)
    state = spawn(world, torch.arange(16), torch.float64)
    return start(state, EnvConfig(world=world, noise_std=0.3), False)


def moved(moment: Moment, matrix: Tensor) -> Moment:
    """Return worlds turned or mirrored about the origin, then shifted."""
    state, shift = moment.state, torch.tensor([3.0, -5.0], dtype=torch.float64)
    points = {
        name: getattr(state, name) @ matrix.T + shift for name in ('sheep', 'shepherds', 'goal')
    }
    return replace(moment, state=replace(state, **points))


def test_features_of_the_state_do_not_change_with_a_turn_a_mirror_or_an_order() -> None:
    moment = moment_of()
    present = moment.state.shepherd_mask
    features = state_features(moment)
    assert features.shape == (16, 4, len(FEATURES))
    assert features.isfinite().all()
    c, s = math.cos(1.1), math.sin(1.1)
    for matrix in ([[c, -s], [s, c]], [[1.0, 0.0], [0.0, -1.0]]):
        other = state_features(moved(moment, torch.tensor(matrix, dtype=torch.float64)))
        torch.testing.assert_close(other[present], features[present])
    state = moment.state
    order, sheep = torch.tensor([2, 0, 3, 1]), torch.randperm(12)
    mixed = replace(
        state, shepherds=state.shepherds[:, order], shepherd_mask=present[:, order],
        sheep=state.sheep[:, sheep],
    )  # fmt: skip
    other = state_features(replace(moment, state=mixed))
    torch.testing.assert_close(other[present[:, order]], features[:, order][present[:, order]])
    far = replace(state, shepherds=torch.where(present[..., None], state.shepherds, 99.0))
    other = state_features(replace(moment, state=far))  # where the absent are does not count
    torch.testing.assert_close(other[present], features[present])


def test_features_by_hand() -> None:
    world = WorldConfig(n_sheep=2, n_shepherds=2, goal_radius=4.0)
    state = spawn(world, torch.arange(1))
    state = replace(
        state,
        sheep=torch.tensor([[[7.0, 0.0], [9.0, 0.0]]]),
        shepherds=torch.tensor([[[8.0, -6.0], [8.0, 4.0]]]),
    )
    values = state_features(start(state, EnvConfig(world=world), False))
    row = dict(zip(FEATURES, values[0, 0].tolist(), strict=True))
    expected = {
        'distance of the flock from the goal': 0.8, 'radius of the goal': 0.4,
        'share of the flock inside': 0.0, 'mean distance of sheep outside from the rim': 0.4,
        'greatest distance of a sheep from the rim': 0.5, 'spread of the flock': 0.1,
        'spread along the line': 0.1, 'spread across the line': 0.0,
        'number of shepherds': 1 / 3, 'noise of perception': 0.0, 'own place along the line': 0.8,
        'own place across': 0.6, 'own distance from the goal': 1.0,
        'own distance from the middle of the flock': 0.6,
        'distance of the nearest sheep': 37**0.5 / 10, 'distance of the nearest shepherd': 1.0,
        'middle of the others along the line': 0.8, 'middle of the others across': -0.4,
        'spread of the others along': 0.0, 'spread of the others across': 0.0,
        'logarithm of the number of sheep': math.log(2) / 5,
    }  # fmt: skip
    assert row == pytest.approx(expected, abs=1e-6)


def test_a_critic_on_the_state_values_what_it_sees_and_leaves_that_of_the_policy() -> None:
    policy = policy_of()
    learner = PPOLearner(policy, PPOConfig(critic_input='state', critic_learning_rate=3e-3))
    critic = learner.state_critic()
    assert isinstance(critic, StateCritic)
    rollout = Rollout(TASK, policy, 2, 4, 6, 3, torch.float32, critic=critic)
    first = rollout.groups[0].moment
    expected = critic(state_features(first)[first.state.shepherd_mask]).detach()
    batch, _ = rollout.collect(0.9, 0.9, 1.0)
    torch.testing.assert_close(batch.value[: len(expected)], expected)
    own = {name: value.clone() for name, value in policy.critic.state_dict().items()}
    losses = [
        learner.update(rollout.store, batch, torch.Generator())['critic_loss'] for _ in '1234'
    ]
    assert losses[-1] < losses[0]
    for name, value in policy.critic.state_dict().items():
        assert torch.equal(value, own[name])
    assert 'critic_network' in learner.state_dict()
    plain = PPOLearner(policy, PPOConfig())
    assert plain.state_critic() is None
    assert 'critic_network' not in plain.state_dict()


def test_an_update_learns_from_a_share_of_the_decisions() -> None:
    config = PPOConfig(learn_share=0.5, update_epochs=2, minibatch_size=10)
    learner = PPOLearner(policy_of(), config)
    parts = list(learner._minibatches(torch.zeros(40), torch.Generator().manual_seed(1)))
    assert [len(part) for part in parts] == [10] * 4
    first, second = set(torch.cat(parts[:2]).tolist()), set(torch.cat(parts[2:]).tolist())
    assert first == second
    assert len(first) == 20


def test_labels_are_the_commands_of_the_teacher_where_the_flock_is_home() -> None:
    policy, task = policy_of(), replace(TASK, home_share=1.0, home_distance_max=8.0)
    rollout = Rollout(task, policy, 2, 6, 4, 3, torch.float32, teacher='drover')
    state = rollout.groups[0].moment.state
    batch, _ = rollout.collect(0.9, 0.9, 1.0)
    assert batch.label is not None
    assert batch.home is not None
    law = make_controller('drover', rollout.groups[0].moment.config.world)
    command, _ = law.act(state, law.begin(state))
    mask = state.shepherd_mask
    count = int(mask.sum())
    result = rotate_by_ray(batch.label[:count], batch.first[:count], 96)
    torch.testing.assert_close(result, command[mask], atol=1e-5, rtol=0)
    home = torch.linalg.vector_norm(state.center - state.goal, dim=-1) <= state.goal_radius
    assert torch.equal(batch.home[:count], home[:, None].expand_as(mask)[mask])
    assert set(batch.home.tolist()) == {False, True}
    learner = PPOLearner(policy, PPOConfig(teacher='drover', label_weight=20.0, target_kl=9.0))
    losses = [
        learner.update(rollout.store, batch, torch.Generator())['label_loss'] for _ in '1234'
    ]
    assert losses[-1] < losses[0]


def test_the_turn_of_a_composite_says_where_it_teaches() -> None:
    labels = HomeLabels('composite:strombom,drover,9,9', 1, torch.Size([2, 3]), 1)
    group = WorldGroup(TASK, 0, 2, 1, CONFIG.lidar)
    group.begin(5)
    labels.begin(0, group.moment)
    labels.add(0, 0, group.moment)
    assert labels.home.all()
    assert HomeLabels('', 1, torch.Size([2, 3]), 1).of((), torch.zeros(1)) == (None, None)
    with pytest.raises(ConfigError, match="controller is 'nobody'"):
        PPOConfig(teacher='nobody')


def test_the_error_against_labels_by_hand() -> None:
    out = torch.tensor([[0.3, 0, 9, 9], [0.0, 0.5, 9, 9]])
    label, home = torch.zeros(2, 2), torch.tensor([True, False])
    assert float(label_loss(policy_of().actor, out, label, home)) == pytest.approx(0.09 / 2)
    two = policy_of(replace(CONFIG, network=replace(CONFIG.network, modes=2))).actor
    out = torch.tensor([[9, 9, 0, 0, 0.3, 0, 0, 0, 0.0], [9, 9, 0, 0, 9, 9, 0, 0, math.log(3)]])
    expected = 0.09 / 2 - 0.1 * (math.log(1 / 2) + math.log(1 / 4)) / 2
    assert float(label_loss(two, out, label, home)) == pytest.approx(expected)


def test_a_new_critic_on_an_old_actor() -> None:
    old, new = policy_of(), Policy(CONFIG)
    critic = {name: value.clone() for name, value in new.critic.state_dict().items()}
    warm_start(new, old, new_critic=True)
    for name, value in new.state_dict().items():
        part, _, rest = name.partition('.')
        assert torch.equal(value, critic[rest] if part == 'critic' else old.state_dict()[name])


def test_effort_can_count_at_home_only() -> None:
    task = replace(TASK, home_share=1.0, home_distance_max=8.0, effort=0.01)
    groups = [
        WorldGroup(replace(task, effort_from=where), 0, 12, 3, CONFIG.lidar)
        for where in ('start', 'home')
    ]
    command = torch.ones(12, 3, 2) * 0.4
    for group in groups:
        group.begin(9)
    state = groups[0].moment.state
    home = torch.linalg.vector_norm(state.center - state.goal, dim=-1) <= state.goal_radius
    everywhere, at_home = (group.hold(command, 1, team_reward) for group in groups)
    free = WorldGroup(replace(task, effort=0.0), 0, 12, 3, CONFIG.lidar)
    free.begin(9)
    nothing = free.hold(command, 1, team_reward)
    assert 0 < home.sum() < 12
    assert torch.equal(at_home, torch.where(home[:, None], everywhere, nothing))


def test_a_batch_without_a_teacher_has_no_labels() -> None:
    batch, _ = Rollout(TASK, policy_of(), 1, 2, 3, 3, torch.float32).collect(0.9, 0.9, 1.0)
    assert isinstance(batch, Batch)
    assert (batch.hold, batch.label, batch.home) == (None, None, None)
