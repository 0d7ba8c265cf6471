"""Times of a policy are in seconds: it sees the same at any time step that keeps them."""

from __future__ import annotations

from dataclasses import replace

import pytest
from shepherd_ros.controllers.policy_controller import LearnedConfig, LearnedController
from shepherd_ros.policy import inference
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.policy.timing import Timing
from shepherd_ros.sim.frames import Frames, nearest_steps
from shepherd_ros.sim.observation import ObservationConfig
from shepherd_ros.sim.presets import world_preset
from shepherd_ros.sim.rollout import advance, EnvConfig, start
from shepherd_ros.sim.spawn import spawn
import torch
from torch import Tensor

CONFIG = PolicyConfig(
    decision_interval=1.0,
    observation=ObservationConfig(n_frames=3, frame_interval=2.0, align='goal', unit=10.0),
    network=NetworkConfig(filters_1=3, filters_2=5, hidden=7),
)
STEPS = (0.05, 0.1, 0.2, 0.25, 0.5, 1.0)


@pytest.fixture(scope='module')
def policy() -> Policy:
    torch.manual_seed(5)
    policy = Policy(CONFIG)
    policy.actor.head.weight.data *= 60.0
    return policy


def reading(time: float) -> Tensor:
    """Return the ranges (1, 3, 512) m at a time [s] of a world that moves in a scripted way."""
    ray = torch.arange(512.0)
    return torch.stack([10 + time + (ray * (k + 1) / 40).sin() for k in range(3)])[None]


@pytest.mark.parametrize(
    ('duration', 'step', 'steps'),
    [
        (4.0, 0.5, 8), (0.5, 0.1, 5), (0.3, 0.1, 3), (0.7, 0.1, 7),  # kept
        (1.0, 0.3, 3), (2.0, 0.3, 7), (0.5, 0.2, 2), (0.7, 0.2, 3),  # nearest, shorter of two
        (0.5, 1.0, 1), (0.5, 10.0, 1),  # a step is longer
    ],
)  # fmt: skip
def test_a_duration_is_the_nearest_number_of_steps_at_least_one(
    duration: float, step: float, steps: int
) -> None:
    assert nearest_steps(duration, step) == steps


def test_times_that_are_kept_and_times_that_are_not_by_hand() -> None:
    for dt in STEPS:
        timing = CONFIG.timing(dt)
        assert timing.action_repeat == round(1 / dt)
        assert timing.frames == Frames(3, 2)
        assert timing.deviation == ''
    odd = CONFIG.timing(0.3)  # 3 steps are 0.9 s, and 2 decisions 1.8 s
    assert (odd.action_repeat, odd.frames.spacing) == (3, 2)
    assert odd.deviation == (
        'decides every 0.9 s instead of 1 s, sees frames 1.8 s apart instead of 2 s, '
        'as a step takes 0.3 s'
    )
    slow = CONFIG.timing(4.0)  # both in one step
    assert (slow.action_repeat, slow.frames.spacing) == (1, 1)
    # frames keep their time where decisions cannot
    coarse = Timing(0.5, 2.0, 3, 1.0)
    assert (coarse.action_repeat, coarse.frames.spacing) == (1, 2)
    assert coarse.deviation == 'decides every 1 s instead of 0.5 s, as a step takes 1 s'
    assert Timing(0.5, 0.5, 1, 1.0).deviation == coarse.deviation  # one frame has no distance


@pytest.mark.parametrize('dt', STEPS)
def test_a_policy_sees_the_same_frames_at_the_same_times(policy: Policy, dt: float) -> None:
    timing = policy.config.timing(dt)
    memory, looked = inference.begin(policy, timing, (), 1), []
    present = torch.tensor([True])
    for step in range(round(9 / dt)):

        def look(step: int = step) -> Tensor:
            looked.append(round(step * dt, 9))
            return reading(looked[-1])

        command, memory = inference.act(policy, timing, look, present, memory, 5.0)
        decided = float(int(step * dt + 1e-9))  # [s]
        times = [max(decided - back, 0.0) for back in (4.0, 2.0, 0.0)]
        frames = torch.stack([reading(time) for time in times], dim=1)
        assert torch.equal(command, policy.act(frames))
    assert looked == [float(k) for k in range(9)]


def test_a_decision_that_was_due_in_lost_steps_is_made_late_and_the_next_in_time(
    policy: Policy,
) -> None:
    timing = policy.config.timing(0.25)  # four steps
    memory, looked = inference.begin(policy, timing, (), 1), []
    before = -1
    for step in (0, 1, 3, 6, 7, 8, 9, 17, 18, 20):

        def look(step: int = step) -> Tensor:
            looked.append(step)
            return reading(step * 0.25)

        present = torch.tensor([True])
        skipped = step - before - 1
        _, memory = inference.act(policy, timing, look, present, memory, 1.0, skipped=skipped)
        before = step
    assert looked == [0, 6, 8, 17, 20]


@pytest.mark.parametrize('dt', [0.1, 0.2, 0.5, 1.0])
def test_the_controller_decides_each_second_of_its_world(policy: Policy, dt: float) -> None:
    world = replace(world_preset(), dt=dt, n_sheep=5, n_shepherds=2)
    controller = LearnedController(LearnedConfig(), world, policy)
    moment = start(spawn(world, torch.tensor([3])), EnvConfig(world=world))
    memory, commands = controller.begin(moment.perceived), []
    for _ in range(round(3 / dt)):
        command, memory = controller.act(moment.perceived, memory)
        commands.append(command)
        moment = advance(moment, command)
    for second in torch.stack(commands).split(round(1 / dt)):
        assert (second == second[0]).all()
    firsts = torch.stack(commands[:: round(1 / dt)])
    assert (firsts[1:] != firsts[:-1]).any(dim=-1).all()
