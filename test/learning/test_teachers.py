"""Controllers that teach: at every step, in one mode, with goals that they know; moving goals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from shepherd_ros.controllers.policy_controller import LearnedConfig, LearnedController
from shepherd_ros.learning.clone import Examples
from shepherd_ros.learning.dagger import LabelledWorlds
from shepherd_ros.learning.dagger_config import DaggerConfig
from shepherd_ros.learning.task import draw_environment, TaskConfig
from shepherd_ros.learning.teachers import make_teacher
from shepherd_ros.policy.checkpoint import save_policy
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.policy.warm_start import drive_mode
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import ObservationConfig
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.transition import step
from shepherd_ros.sim.world import WorldConfig
import torch

NETWORK = NetworkConfig(filters_1=4, filters_2=4, hidden=16, modes=2)
CONFIG = PolicyConfig(lidar=LidarConfig(n_rays=96), network=NETWORK)
WORLD = WorldConfig(n_sheep=6, n_shepherds=2)
TASK = TaskConfig(sheep_min=6, sheep_max=6, shepherds_max=3, episode_steps=40)


def policy_of(config: PolicyConfig = CONFIG) -> Policy:
    """Return a policy whose gate and means differ from state to state."""
    torch.manual_seed(5)
    policy = Policy(config)
    policy.actor.head.weight.data *= 60
    x = torch.rand(64, 3, 288)
    policy.actor.head.bias.data[-1] -= policy.actor.outputs(x)[:, -1].median().detach()
    return policy


@pytest.mark.parametrize('std_type', ['state', 'free'])
def test_the_drive_mode_alone_acts_as_the_two_where_the_gate_drives(std_type: str) -> None:
    two = policy_of(replace(CONFIG, network=replace(NETWORK, std_type=std_type))).requires_grad_(
        False
    )
    if std_type == 'free':
        two.actor.log_std.data[1] -= 1.0
    before = {name: value.clone() for name, value in two.state_dict().items()}
    one, x = drive_mode(two), torch.rand(64, 3, 288)
    assert one.config.network.modes == 1
    drives = torch.zeros(64, dtype=torch.bool)
    for own, expected in zip(one.actor(x), two.actor(x, drives), strict=True):
        torch.testing.assert_close(own, expected, atol=1e-5, rtol=0)
    assert torch.equal(one.critic(x), two.critic(x))
    assert drive_mode(one) is one
    assert all(torch.equal(value, before[name]) for name, value in two.state_dict().items())


def test_a_policy_that_teaches_decides_at_every_step(tmp_path: Path) -> None:
    observation = ObservationConfig(frame_interval=2.0)  # as far apart with either interval
    config = replace(CONFIG, decision_interval=2.0, observation=observation)
    held, each = policy_of(config), policy_of(replace(config, decision_interval=0.5))
    for policy in (held, each):
        policy.actor.head.bias.data[-1] += 100  # the gate always chooses to hold
    save_policy(tmp_path / 'held.safetensors', held, {})
    word = f'policy:{tmp_path / "held.safetensors"}'
    # as a composite says when to hold, a policy that drives in it does nothing else
    pairs = {word: each, f'composite:{word},idle,0,0': drive_mode(each)}
    answers = []
    for name, policy in pairs.items():
        laws = LearnedController(LearnedConfig(), WORLD, policy), make_teacher(name, WORLD)
        state = spawn(WORLD, torch.arange(3))
        memories = [law.begin(state) for law in laws]
        for _ in range(7):
            commands = []
            for k, law in enumerate(laws):
                command, memories[k] = law.act(state, memories[k])
                commands.append(command)
            assert torch.equal(commands[0], commands[1])
            state = step(state, commands[0], WORLD)
        answers.append(state.shepherds)
    assert not torch.equal(*answers)


def test_a_policy_that_teaches_is_shown_no_wider_goal_than_it_knows(tmp_path: Path) -> None:
    save_policy(tmp_path / 'p.safetensors', policy_of(), {})
    state = spawn(replace(WORLD, goal_radius=8.0), torch.arange(4))
    narrow = replace(state, goal_radius=torch.full_like(state.goal_radius, 6.0))

    def answer(name: str, seen: object, **options: float) -> torch.Tensor:
        teacher = make_teacher(name, WORLD, **options)
        return teacher.act(seen, teacher.begin(seen))[0]

    word = f'policy:{tmp_path / "p.safetensors"}'
    for name in (word, f'composite:{word},idle,0,0'):
        assert torch.equal(answer(name, state, widest_goal=6.0), answer(name, narrow))
        assert torch.equal(answer(name, narrow, widest_goal=7.0), answer(name, narrow))
        assert not torch.equal(answer(name, state), answer(name, narrow))
    # a heuristic sees the goal as it is
    assert torch.equal(answer('drover', state, widest_goal=6.0), answer('drover', state))


def test_a_learner_acts_in_its_training_by_the_samples_that_it_will_act_by() -> None:
    policy = policy_of(replace(CONFIG, sample_std=0.3)).requires_grad_(False)
    config = DaggerConfig(task=TASK, worlds=3, groups=1, teacher='composite:idle,drover')
    lesson = LabelledWorlds(config, policy, 0, torch.float32)
    moment, examples = lesson.group.moment, Examples(policy, 100, torch.float32)
    law = LearnedController(LearnedConfig(), moment.config.world, policy)
    memory = law.begin(moment.state)
    for _ in range(4):
        moment = lesson.group.moment
        command, memory = law.act(moment.state, memory)
        lesson.run(1, False, examples)
        assert torch.equal(lesson.learned['command'], command)
    mean = policy_of()
    by_mean = LearnedController(LearnedConfig(), moment.config.world, mean)
    assert not torch.equal(by_mean.act(moment.state, by_mean.begin(moment.state))[0], command)


def test_goals_of_a_training_stand_or_move_at_any_speed_on_both_paths() -> None:
    moving = replace(TASK, goal_speed_max=0.2, goal_still_share=0.25)
    worlds = [draw_environment(moving, seed).world for seed in range(1000)]
    speeds = torch.tensor([world.goal_speed for world in worlds])
    assert float((speeds == 0).float().mean()) == pytest.approx(0.25, abs=0.05)
    assert float(speeds[speeds > 0].mean()) == pytest.approx(0.1, abs=0.01)
    assert float(speeds.max()) <= 0.2
    circles = sum(world.goal_path == 'circle' for world in worlds)
    assert circles == pytest.approx(500, abs=60)
    # all else is drawn as without
    for world, seed in zip(worlds[:50], range(50), strict=True):
        still = replace(world, goal_speed=0.0, goal_path='straight')
        assert still == draw_environment(TASK, seed).world
