"""Two modes of an action, drive and hold: the gate, its lessons, its export, and PPO."""

from __future__ import annotations

from dataclasses import replace
import math
from pathlib import Path

import numpy as np
import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.controllers import make_controller
from shepherd_ros.controllers.composite import HOME
from shepherd_ros.datasets.dataset_report import Report
from shepherd_ros.datasets.steps import Steps
from shepherd_ros.learning.bag_modes import holding
from shepherd_ros.learning.clone import CloneConfig, CloneLearner, Examples
from shepherd_ros.learning.dagger import LabelledWorlds
from shepherd_ros.learning.dagger_config import DaggerConfig
from shepherd_ros.learning.held_out import held_out_results, is_held_out
from shepherd_ros.learning.ppo import PPOConfig, PPOLearner
from shepherd_ros.learning.ppo_rollout import log_prob, Rollout
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.learning.teachers import make_teacher
from shepherd_ros.learning.train_bc import BCConfig, stream_examples
from shepherd_ros.policy.checkpoint import load_policy, save_policy
from shepherd_ros.policy.network import Actor, NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.policy.torchscript import export_actor
from shepherd_ros.policy.warm_start import warm_start
from shepherd_ros.recordings.record import record_episodes
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import rotate_by_ray
from shepherd_ros.sim.presets import home_world
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import WorldConfig
import torch

ONE = NetworkConfig(filters_1=4, filters_2=4, hidden=16)
TWO = replace(ONE, modes=2)
CONFIG = PolicyConfig(lidar=LidarConfig(n_rays=96), network=TWO)
SHAPE = (3, 288)
TASK = TaskConfig(sheep_min=6, sheep_max=6, shepherds_max=3, episode_steps=40)


def policy_of(config: PolicyConfig = CONFIG) -> Policy:
    """Return a policy whose gate and means differ from state to state."""
    torch.manual_seed(5)
    policy = Policy(config)
    policy.actor.head.weight.data *= 60
    if config.network.modes == 2:
        x = torch.rand(64, *SHAPE)
        policy.actor.head.bias.data[-1] -= policy.actor.outputs(x)[:, -1].median().detach()
    return policy


@pytest.mark.parametrize('std_type', ['state', 'free'])
def test_an_action_is_that_of_the_mode_that_the_gate_chooses(std_type: str) -> None:
    actor = policy_of(replace(CONFIG, network=replace(TWO, std_type=std_type))).actor
    if std_type == 'free':
        actor.log_std.data[1] -= 1.0
    x = torch.rand(64, *SHAPE)
    with torch.no_grad():
        out = actor.outputs(x)
        mean, std = actor(x)
        gate = actor.gate(out)
        assert gate is not None
        hold = gate > 0
        assert 0 < hold.sum() < 64
        for mode in (False, True):
            own = torch.full((64,), mode)
            of_mode = actor(x, own)
            assert torch.equal(mean[hold == mode], of_mode[0][hold == mode])
            assert torch.equal(std[hold == mode], of_mode[1][hold == mode])
        width = 4 if std_type == 'state' else 2
        assert out.shape == (64, 2 * width + 1)
        assert torch.equal(actor(x, ~hold)[0][hold], out[hold, :2])
        assert torch.equal(actor(x, hold)[0][hold], out[hold, width : width + 2])


def test_one_mode_has_no_gate_and_no_more_weights() -> None:
    actor = Actor(SHAPE, ONE)
    out = torch.rand(3, 4)
    assert actor.gate(out) is None
    assert actor.hold(out) is None
    assert actor.head.weight.shape == (4, 16)
    assert 'modes' not in ONE.to_dict()
    assert torch.equal(actor.action_of(out)[0], out[:, :2])


def test_a_checkpoint_and_exports_have_the_gate(tmp_path: Path) -> None:
    policy = policy_of()
    save_policy(tmp_path / 'two.safetensors', policy, {})
    back, frames = load_policy(str(tmp_path / 'two.safetensors')), 9 * torch.rand(8, 3, 3, 96)
    assert torch.equal(back.act(frames), policy.act(frames))
    for name in ('actor.pt', 'actor.onnx'):
        assert export_actor(policy, tmp_path / name) < 1e-5
    frames = torch.where(frames < 5, frames, torch.inf)
    run = torch.jit.load(str(tmp_path / 'actor.pt'))
    torch.testing.assert_close(run(frames), policy.act(frames), atol=1e-5, rtol=0)


@pytest.mark.parametrize('std_type', ['state', 'free'])
def test_both_modes_can_begin_as_the_one_of_another_policy(std_type: str) -> None:
    networks = [replace(network, std_type=std_type) for network in (ONE, TWO)]
    one, two = (policy_of(replace(CONFIG, network=network)) for network in networks)
    warm_start(two, one)
    x = torch.rand(16, *SHAPE)
    for hold in (False, True, None):
        mode = None if hold is None else torch.full((16,), hold)
        for a, b in zip(two.actor(x, mode), one.actor(x), strict=True):
            torch.testing.assert_close(a, b)
    assert torch.equal(two.critic(x), one.critic(x))


def examples_with(policy: Policy, wanted: list[list[float]], **columns: torch.Tensor) -> Examples:
    examples, count = Examples(policy, 8, torch.float32), len(wanted)
    frames, first = torch.zeros(count, 3, 3, 96), torch.zeros(count).long()
    examples.add(frames, first, torch.tensor(wanted), **columns)
    return examples


def test_the_loss_of_two_modes_by_hand() -> None:
    policy = policy_of()
    head = policy.actor.head
    torch.nn.init.zeros_(head.weight)
    # means (0.1, 0) and (0.4, 0), and a gate that says hold with probability 3/4
    head.bias.data = torch.tensor([0.1, 0, 0, 0, 0.4, 0, 0, 0, math.log(3.0)])
    hold = torch.tensor([False, True])
    examples = examples_with(policy, [[0.0, 0.0], [0.0, 0.0]], hold=hold)
    config = CloneConfig(huber_delta=9.0, gate_weight=0.5, hold_weight=2.0)
    learner = CloneLearner(policy, config, 0)
    parts = [0.1**2 - 0.5 * math.log(1 / 4), 2 * 0.4**2 - 0.5 * math.log(3 / 4)]
    for chosen, expected in (([0], parts[0]), ([1], parts[1]), ([0, 1], sum(parts) / 2)):
        loss = learner.loss(examples, torch.tensor(chosen)).detach()
        assert float(loss) == pytest.approx(expected)
    learner.loss(examples, torch.tensor([0])).backward()
    gradient = head.bias.grad
    assert gradient is not None
    assert gradient[4:8].abs().max() == 0  # nothing is learned of the other mode
    assert gradient[0] == pytest.approx(0.2)
    assert gradient[8] == pytest.approx(0.5 * 0.75)


def test_errors_of_a_weighted_example_and_of_a_cut_mean_by_hand() -> None:
    policy = policy_of(replace(CONFIG, network=ONE))
    torch.nn.init.zeros_(policy.actor.head.weight)
    policy.actor.head.bias.data = torch.tensor([3.0, 4.0, 0, 0])  # 5 m/s
    examples = examples_with(policy, [[0.6, 0.8], [0.0, 0.0]], weight=torch.tensor([3.0, 1.0]))
    both = torch.tensor([0, 1])
    plain = CloneLearner(policy, CloneConfig(huber_delta=9.0), 0)
    assert float(plain.loss(examples, both)) == pytest.approx((3 * 16 + 25) / 4)
    cut = CloneLearner(policy, CloneConfig(huber_delta=9.0, clip_speed=1.0), 0)
    assert float(cut.loss(examples, both)) == pytest.approx((3 * 0 + 1) / 4)
    below = CloneLearner(policy, CloneConfig(huber_delta=9.0, clip_speed=6.0), 0)
    assert float(below.loss(examples, both)) == pytest.approx((3 * 16 + 25) / 4)


def test_lessons_carry_the_turn_of_the_teacher_and_the_weight_of_a_team() -> None:
    policy = policy_of()
    task = replace(TASK, home_share=0.5, episode_steps=400)
    config = DaggerConfig(
        task=task, worlds=24, groups=1, example_interval=1, example_team_exponent=2.0,
        teacher='composite:strombom,drover,0.5,1.5',
    )  # fmt: skip
    seen = set()
    for index in range(4):
        lesson = LabelledWorlds(config, policy, index, torch.float32)
        state, examples = lesson.group.moment.state, Examples(policy, 100, torch.float32)
        lesson.run(1, False, examples)
        law = make_controller('composite', lesson.group.moment.config.world, home_within=0.5)
        command, memory = law.act(state, law.begin(state))
        count = int(state.shepherd_mask.sum())
        result = rotate_by_ray(examples.wanted[:count], examples.first[:count], 96)
        torch.testing.assert_close(result, command[state.shepherd_mask], atol=1e-5, rtol=0)
        rows = state.shepherd_mask.nonzero()[:, 0]
        assert torch.equal(examples.hold[:count], memory[HOME][rows])
        weight = 1.0 / state.team_size[rows].float() ** 2
        torch.testing.assert_close(examples.weight[:count], weight)
        seen |= set(examples.hold[:count].tolist())
    assert seen == {False, True}


def test_two_modes_ask_for_a_composite_teacher() -> None:
    config = DaggerConfig(task=TASK, worlds=1, groups=1)
    with pytest.raises(ConfigError, match="teacher is 'drover': expected composite:DRIVE,HOLD"):
        LabelledWorlds(config, policy_of(), 0, torch.float32)


def steps_at(*distances: float) -> Steps:
    """Return steps of two shepherds with the flock so far from the goal [goal radii]."""
    count = 2 * len(distances)
    return Steps(
        bag='bag', episode=0, seed=0, n_sheep=1, n_shepherds=2, dt=0.5,
        step=np.repeat(np.arange(len(distances)), 2), shepherd=np.tile([0, 1], len(distances)),
        lidar=np.zeros((count, 3, 96), np.float32), action=np.zeros((count, 2), np.float32),
        home_distance=np.repeat(np.array(distances, np.float32), 2),
    )  # fmt: skip


def test_recorded_steps_hold_as_a_composite_does() -> None:
    # home at 0.75, no longer beyond 2, and not again before 0.75
    steps = steps_at(3.0, 1.5, 0.75, 1.5, 2.0, 2.1, 1.5, 0.7, np.nan)
    expected = [False, False, True, True, True, False, False, True, False]
    assert holding(steps, 0.75, 2.0).tolist() == [hold for hold in expected for _ in range(2)]
    for unknown in (steps_at(np.nan), replace(steps, home_distance=np.zeros(0, np.float32))):
        with pytest.raises(ConfigError, match='bag:0: the distance of the flock from the goal is'):
            holding(unknown, 0.75, 2.0)


def test_cloning_learns_the_modes_of_a_composite_from_its_bags(tmp_path: Path) -> None:
    bags, policy = tmp_path / 'bags', policy_of()
    world = home_world(WorldConfig(n_sheep=5, n_shepherds=2, episode_steps=6))
    teacher = make_teacher('composite:idle,drover,0.5,0.9', world)
    record_episodes(EnvConfig(world=world, lidar=CONFIG.lidar), teacher, range(4), bags)
    config = BCConfig(home_within=0.5, away_beyond=0.9)
    ((_, _, wanted, hold), *others) = stream_examples([bags], policy, Report(), config)
    rows = [(wanted, hold), *((w, h) for _, _, w, h in others)]
    # idle drives and stands, drover holds and moves
    for wanted, hold in rows:
        assert torch.equal(wanted.norm(dim=-1) > 1e-6, hold)
    assert any(hold.any() for _, hold in rows)
    assert not all(hold.all() for _, hold in rows)


def test_held_out_bags_judge_a_clone_by_hand() -> None:
    policy = policy_of()
    frames = policy.scale(torch.full((4, 3, 3, 96), 9.0))
    first = torch.zeros(4, dtype=torch.int64)
    with torch.no_grad():
        out = policy.actor.outputs(policy.arrange(frames, first))
        mean, chosen = policy.actor.action_of(out)[0], policy.actor.hold(out)
    target = mean + torch.tensor([0.3, 0.4])  # 0.5 m/s off
    right = torch.tensor([True, True, True, False])
    batch = (frames, first, target, chosen == right)
    results = held_out_results(policy, [batch, batch], 0.0, torch.float32)
    assert results == pytest.approx({'held_out_error': 0.5, 'gate_accuracy': 0.75})
    assert held_out_results(policy, [], 0.0, torch.float32) == {}
    assert [k for k in range(10) if is_held_out(k, 0.2)] == [4, 9]
    with pytest.raises(ConfigError, match='expected more with offline'):
        BCConfig(offline=True)


def test_ppo_learns_of_the_mode_that_acted_and_leaves_the_gate_alone() -> None:
    policy = policy_of()
    policy.actor.head.weight.data[-1] *= 9
    rollout = Rollout(TASK, policy, 2, 4, 6, 3, torch.float32)
    batch, _ = rollout.collect(0.9, 0.9, 1.0)
    assert batch.hold is not None
    assert 0 < batch.hold.sum() < len(batch.hold)
    x = rollout.store.inputs(batch.rows, batch.first)
    with torch.no_grad():
        assert torch.equal(policy.actor.hold(policy.actor.outputs(x)), batch.hold)
        mean, std = policy.actor(x, batch.hold)
        torch.testing.assert_close(log_prob(batch.action, mean, std), batch.log_prob)
    gate = policy.actor.head.weight[-1].detach().clone()
    means = policy.actor.head.weight[:8].detach().clone()
    PPOLearner(policy, PPOConfig()).update(rollout.store, batch, torch.Generator())
    assert torch.equal(policy.actor.head.weight[-1], gate)
    assert (policy.actor.head.weight[:8] != means).any(dim=-1).all()
