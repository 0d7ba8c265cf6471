"""From scans to actions: which way is front, when a policy decides, what it remembers."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
import math

import pytest
from reference import make_state
from shepherd_ros.config import ConfigError
from shepherd_ros.controllers.policy_controller import (
    LearnedConfig,
    LearnedController,
    sample_noise,
)
from shepherd_ros.policy import inference
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.lidar import LidarConfig, scan
from shepherd_ros.sim.observation import first_ray, ObservationConfig, rotate_by_ray
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor

GOALWARD = ObservationConfig(align='goal')


def goal_scan(x: float, y: float, radius: float, n_rays: int = 512) -> Tensor:
    """Return the scan (3, R) m of a shepherd at x, y with the goal at the origin."""
    state = make_state(0, 3, 1, dtype=torch.float32)
    state.shepherds[:] = torch.tensor([x, y])
    state.goal[:] = 0.0
    state.goal_radius.fill_(radius)
    return scan(state, LidarConfig(n_rays=n_rays))[0]


def policy_of(**options: object) -> Policy:
    torch.manual_seed(5)
    return Policy(PolicyConfig(**options))  # type: ignore[arg-type]


def test_the_first_ray_points_to_the_middle_of_the_goal() -> None:
    for radius, distance, bearing in product(
        [1.0, 4.0, 8.0], [3.0, 7.0, 30.0], [0.0, 0.7, 2.0, -3.0, math.pi]
    ):
        # from outside and from inside
        ranges = goal_scan(-distance * math.cos(bearing), -distance * math.sin(bearing), radius)
        result = float(first_ray(ranges, GOALWARD)) * 2 * math.pi / 512
        off = math.remainder(result - bearing, 2 * math.pi)
        assert abs(off) < 2 * math.pi / 512  # one ray


def test_without_goal_in_sight_or_aligned_with_the_world_the_first_ray_is_ray_0() -> None:
    empty = torch.full((2, 3, 512), math.inf)
    assert first_ray(empty, GOALWARD).tolist() == [0, 0]
    assert first_ray(goal_scan(3.0, 9.0, 4.0), ObservationConfig()) == 0


def test_turned_by_hand() -> None:
    vector = torch.tensor([[1.0, 0.0], [1.0, 0.0], [0.0, 2.0], [3.0, 4.0]])
    result = rotate_by_ray(vector, torch.tensor([0, 128, 256, 512]), 512)
    expected = torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.0, -2.0], [3.0, 4.0]])
    torch.testing.assert_close(result, expected, atol=1e-6, rtol=0)
    torch.testing.assert_close(
        rotate_by_ray(result, torch.tensor([0, -128, -256, -512]), 512), vector
    )


def test_with_the_goal_in_front_a_turned_world_gets_turned_actions() -> None:
    policy = policy_of(observation=GOALWARD)
    ranges = torch.stack([goal_scan(9.0, 4.0, 4.0) + 0.01 * k for k in range(3)])[None]
    action = policy.act(ranges)
    for rays in (1, 37, 256, 511):
        result = policy.act(ranges.roll(rays, dims=-1))
        torch.testing.assert_close(
            result, rotate_by_ray(action, torch.tensor([rays]), 512), atol=1e-5, rtol=0
        )


def test_actions_are_held_and_frames_are_apart_as_told() -> None:
    observation = ObservationConfig(n_frames=3, frame_interval=2.0)
    policy = policy_of(decision_interval=1.0, observation=observation)
    timing = policy.config.timing(0.5)
    readings = [torch.full((1, 3, 512), float(t + 1)) for t in range(14)]
    memory = inference.begin(policy, timing, (), 1)
    present = torch.tensor([True])
    looked = []
    for t, reading in enumerate(readings):

        def look(t: int = t, reading: Tensor = reading) -> Tensor:
            looked.append(t)
            return reading

        command, memory = inference.act(policy, timing, look, present, memory, 1.0)
        decided = t - t % 2
        frames = [max(decided - back, 0) for back in (8, 4, 0)]
        stack = torch.stack([readings[k] for k in frames], dim=1)
        torch.testing.assert_close(command, policy.act(stack).clamp(-1, 1), atol=1e-5, rtol=0)
    assert looked == list(range(0, 14, 2))


def test_a_command_is_at_most_the_top_speed_and_the_absent_keep_still() -> None:
    policy = policy_of()
    policy.actor.head.bias.data = torch.tensor([30.0, 40.0, 0.0, 0.0])
    timing = policy.config.timing(0.5)
    memory = inference.begin(policy, timing, (2,), 2)
    present = torch.tensor([[True, False], [False, True]])
    command, memory = inference.act(
        policy, timing, lambda: torch.full((2, 2, 3, 512), math.inf), present, memory, 0.5
    )
    speed = command.norm(dim=-1)
    torch.testing.assert_close(speed, 0.5 * present.float())
    assert torch.equal(memory['command'], command)


def test_the_controller_sees_what_the_environment_shows() -> None:
    world = WorldConfig(n_sheep=15, n_shepherds=2)
    observation = ObservationConfig(frame_interval=1.5, align='goal', unit=20.0)
    policy = policy_of(observation=observation)
    env = ShepherdEnv(EnvConfig(world=world, observation=observation, noise_std=0.3), 3)
    controller = LearnedController(LearnedConfig(), world, policy)
    stack, _ = env.reset(4)
    memory = controller.begin(env.perceived)
    for _ in range(10):
        assert stack is not None
        command, memory = controller.act(env.perceived, memory)
        direct = policy.act(stack.flatten(0, 1)).unflatten(0, (3, 2))
        cut = direct / direct.norm(dim=-1, keepdim=True).clamp(min=1.0)
        torch.testing.assert_close(command, cut, atol=1e-5, rtol=0)
        stack, *_ = env.step(command)


def test_samples_of_a_given_spread_are_that_far_from_the_mean_and_the_same_again() -> None:
    world = WorldConfig(shepherd_speed=9.0)  # nothing is cut
    state = make_state(3, 10, 3, dtype=torch.float32)
    policy = policy_of()

    def act(std: float) -> Tensor:
        controller = LearnedController(LearnedConfig(sample_std=std), world, policy)
        return controller.act(state, controller.begin(state))[0]

    mean, offset = act(0.0), sample_noise(state.seed, state.step, 3)
    # the policy looks along the world's axes, so that draws do, too
    for std in (0.08, 0.5):
        torch.testing.assert_close(act(std), mean + std * offset)
        assert torch.equal(act(std), act(std))
    with pytest.raises(ConfigError, match=r'sample_std is 0.1 m/s: expected -1 with sample'):
        LearnedConfig(sample=True, sample_std=0.1)


def test_the_spread_is_that_of_the_checkpoint_unless_another_is_given() -> None:
    world = WorldConfig(shepherd_speed=9.0)  # nothing is cut
    state = make_state(3, 10, 3, dtype=torch.float32)
    policy = policy_of()
    drawing = policy.with_config(replace(policy.config, sample_std=0.2))

    def act(policy: Policy, **options: float) -> Tensor:
        controller = LearnedController(LearnedConfig(**options), world, policy)
        return controller.act(state, controller.begin(state))[0]

    mean, offset = act(policy), sample_noise(state.seed, state.step, 3)
    assert torch.equal(act(policy, sample_std=0.0), mean)
    torch.testing.assert_close(act(drawing), mean + 0.2 * offset)
    torch.testing.assert_close(act(drawing, sample_std=0.5), mean + 0.5 * offset)
    assert torch.equal(act(drawing, sample_std=0.0), mean)
    assert torch.equal(act(drawing, sample=True), act(policy, sample=True))


def test_sampled_actions_are_a_function_of_seed_and_step() -> None:
    world = WorldConfig()
    state = make_state(3, 10, 3, dtype=torch.float32)
    policy = policy_of()

    def act(sample: bool) -> Tensor:
        controller = LearnedController(LearnedConfig(sample=sample), world, policy)
        return controller.act(state, controller.begin(state))[0]

    assert torch.equal(act(True), act(True))
    assert not torch.allclose(act(True), act(False), atol=0.05)
