"""Learning in a task with terminal states: they are not bootstrapped, and worlds begin anew."""

from __future__ import annotations

from dataclasses import replace

import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.controllers.policy_controller import require_task
from shepherd_ros.learning.gae import advantages
from shepherd_ros.learning.ppo_rollout import Rollout
from shepherd_ros.learning.task import draw_environment, task_defaults, TaskConfig
from shepherd_ros.policy.checkpoint import read_checkpoint_metadata, save_policy
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import ObservationConfig
from shepherd_ros.sim.presets import world_preset
import torch

TASK = replace(
    task_defaults(TaskConfig(), 'protection'),
    sheep_min=150,
    sheep_max=150,
    shepherds_max=2,
    episode_steps=60,
)


def policy() -> Policy:
    torch.manual_seed(7)
    return Policy(
        PolicyConfig(
            task='protection',
            decision_interval=1.0,
            lidar=LidarConfig(n_rays=32),
            observation=ObservationConfig(frame_interval=1.0, unit=10.0),
            network=NetworkConfig(filters_1=2, filters_2=2, hidden=8),
        )
    )


def test_after_a_terminal_state_nothing_is_expected_and_after_a_limit_the_value() -> None:
    reward = torch.tensor([[1.0, 1.0], [2.0, 2.0], [4.0, 4.0]])
    value = torch.tensor([[10.0, 10.0], [20.0, 20.0], [30.0, 30.0]])
    following = torch.tensor([[20.0, 20.0], [0.0, 7.0], [5.0, 5.0]])  # terminal, limit at t = 1
    ended = torch.tensor([[False, False], [True, True], [False, False]])
    computed = advantages(reward, value, following, ended, 0.5, 0.5)
    assert computed[:, 0].tolist() == [1 + 10 - 10 + 0.25 * (2 - 20), 2 + 0 - 20, 4 + 2.5 - 30]
    assert computed[:, 1].tolist() == [
        1 + 10 - 10 + 0.25 * (2 + 3.5 - 20),
        2 + 3.5 - 20,
        4 + 2.5 - 30,
    ]


def test_worlds_that_end_begin_anew_alone_and_their_frames_with_them() -> None:
    rollout = Rollout(TASK, policy(), 2, 6, 20, 3, torch.float32)
    seen = []

    def reward(moment: object) -> torch.Tensor:
        state = moment.state  # type: ignore[attr-defined]
        assert not state.step.max() > 60
        gained = moment.reward[:, None].expand(state.shepherd_mask.shape)  # type: ignore[attr-defined]
        seen.append(gained)
        return gained

    rollout.reward = reward
    stored = {}
    batch = rollout._batch

    def keep(made: object, *numbers: float) -> object:
        stored['made'] = made
        return batch(made, *numbers)  # type: ignore[arg-type]

    rollout._batch = keep  # type: ignore[assignment,method-assign]
    rollout.collect(0.9, 0.9, 1.0)
    made = stored['made']
    together = made.ended.all(dim=-1)  # type: ignore[attr-defined]
    alone = made.ended & ~together[..., None]  # type: ignore[attr-defined]
    assert alone.any()
    assert together.any()
    assert (made.next_value[alone] == 0).all()  # type: ignore[attr-defined]
    crashed = made.reward.amin(dim=-1) < -1.9  # type: ignore[attr-defined]
    assert torch.equal(crashed & ~together[..., None], alone)
    # frames do not reach over the start of a world
    g, t, world = alone.nonzero()[0].tolist()
    row = rollout.store.before + t + 1
    assert int(rollout.store.begun[g, row, world]) == row
    others = [b for b in range(6) if not alone[g, t, b]]
    assert (rollout.store.begun[g, row, others] < row).all()


def test_a_rollout_goes_on_from_its_state_as_it_would_have() -> None:
    first = Rollout(TASK, policy(), 2, 6, 5, 3, torch.float32)
    for _ in range(2):
        first.collect(0.9, 0.9, 1.0)
        first.roll()
    state = first.state_dict()
    other = Rollout(TASK, policy(), 2, 6, 5, 3, torch.float32)
    other.load_state_dict(state)
    for _ in range(3):
        a, b = first.collect(0.9, 0.9, 1.0)[0], other.collect(0.9, 0.9, 1.0)[0]
        assert torch.equal(a.advantage, b.advantage)
        assert torch.equal(a.action, b.action)
        first.roll()
        other.roll()


def test_a_task_has_its_own_defaults_of_training() -> None:
    config = draw_environment(task_defaults(TaskConfig(), 'protection'), 3)
    assert config.world.task.name == 'protection'
    assert 20 <= config.world.n_sheep <= 60
    assert (config.world.goal_radius, config.world.spawn.goal_radius_extra) == (1.5, 1.5)
    assert config.world.goal_speed == pytest.approx(1 / 3)


def test_a_checkpoint_says_its_task_and_fits_no_other(tmp_path: object) -> None:
    path = tmp_path / 'p.safetensors'  # type: ignore[operator]
    save_policy(path, policy(), {})
    assert read_checkpoint_metadata(path)[0].task == 'protection'
    require_task(policy(), world_preset(task='protection'))
    with pytest.raises(ConfigError, match='task is herding: expected protection, for which'):
        require_task(policy(), world_preset())
    assert 'task' not in PolicyConfig().to_dict()
