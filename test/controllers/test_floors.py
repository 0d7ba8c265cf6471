"""The floors, controllers that do not look, and what all controllers share."""

from __future__ import annotations

from dataclasses import replace
import math

import pytest
from reference import assert_near, batch, make_state, padded
from shepherd_ros.controllers import CONTROLLERS, make_controller
from shepherd_ros.controllers.controller import Controller, places_on_arc
from shepherd_ros.controllers.policy_controller import sample_noise
from shepherd_ros.sim.rng import direction, normal, Stream
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.transition import step
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor


def random_command(state: WorldState, **options: object) -> Tensor:
    controller = make_controller('random', WorldConfig(), **options)
    return controller.act(state, controller.begin(state))[0]


def at_step(state: WorldState, value: int) -> WorldState:
    return replace(state, step=torch.full_like(state.step, value))


# --- floors -------------------------------------------------------------------------------------


@pytest.mark.parametrize('dtype', [torch.float32, torch.float64], ids=str)
def test_an_idle_shepherd_commands_zero(dtype: torch.dtype) -> None:
    controller = make_controller('idle', WorldConfig())
    for state in (make_state(1, 5, 3), batch([make_state(1, 5, 3), make_state(2, 9, 6)])):
        seen = state.to(dtype)
        command, memory = controller.act(seen, controller.begin(seen))
        assert torch.equal(command, torch.zeros_like(seen.shepherds))
        assert memory == {}


@pytest.mark.parametrize('top', [0.0, 0.7, 2.0])
def test_a_random_shepherd_commands_its_top_speed_in_a_drawn_direction(top: float) -> None:
    state = at_step(make_state(1, 5, 4), 17)
    controller = make_controller('random', WorldConfig(shepherd_speed=top), hold_steps=5)
    command, memory = controller.act(state, controller.begin(state))
    drawn = direction(state.seed, torch.tensor(3), Stream.CONTROL, torch.arange(4), torch.float64)
    assert_near(command, top * drawn, 1e-9)
    assert memory == {}


@pytest.mark.parametrize('hold', [1, 8])
def test_a_random_direction_is_kept_for_as_many_steps_as_told(hold: int) -> None:
    state = make_state(1, 5, 2)
    directions = torch.stack(
        [random_command(at_step(state, t), hold_steps=hold) for t in range(24)]
    )
    changes = (directions[1:] != directions[:-1]).any(dim=-1).all(dim=-1)
    assert changes.tolist() == [(t + 1) % hold == 0 for t in range(23)]
    assert changes.tolist() == (directions[1:] != directions[:-1]).any(dim=-1).any(dim=-1).tolist()


def test_random_directions_are_even_all_round_and_differ_between_shepherds_and_seeds() -> None:
    states = [replace(make_state(1, 1, 20), seed=torch.tensor(seed)) for seed in range(500)]
    directions = random_command(batch(states)).reshape(-1, 2)
    angle = torch.atan2(directions[:, 1], directions[:, 0])
    share = torch.histc(angle, bins=8, min=-math.pi, max=math.pi) / len(angle)
    assert (share - 1 / 8).abs().max() < 0.02
    assert len(angle.unique()) > 9_900
    assert directions.mean(dim=0).abs().max() < 0.05


def test_a_random_shepherd_does_not_look() -> None:
    state = make_state(1, 5, 3)
    elsewhere = replace(make_state(2, 5, 3), seed=state.seed, step=state.step)
    assert torch.equal(random_command(state), random_command(elsewhere))


# --- sampled actions ----------------------------------------------------------------------------


def test_a_sampled_action_has_two_draws_for_each_shepherd_whatever_the_team() -> None:
    seed, at = torch.tensor([5, -6]), torch.tensor([1, 9])
    drawn = normal(seed, at, Stream.ACTION, torch.arange(8))
    for team in (1, 2, 3, 4):
        expected = drawn[:, : 2 * team].reshape(2, team, 2)
        assert torch.equal(sample_noise(seed, at, team), expected)


# --- what all controllers share -----------------------------------------------------------------


@pytest.mark.parametrize('name', sorted(CONTROLLERS))
def test_a_controller_answers_the_same_state_with_the_same_commands(name: str) -> None:
    controller = make_controller(name, WorldConfig())
    assert isinstance(controller, Controller)
    assert CONTROLLERS[name].name == name
    state = make_state(4, 20, 3)
    memory = controller.begin(state)
    stored = {key: value.clone() for key, value in memory.items()}
    first, after = controller.act(state, memory)
    again, _ = controller.act(state, memory)
    assert torch.equal(first, again)
    assert all(torch.equal(memory[key], stored[key]) for key in stored)  # handed in, not changed
    assert set(after) == set(memory)


@pytest.mark.parametrize('name', sorted(CONTROLLERS))
def test_a_controller_takes_any_leading_axes(name: str) -> None:
    controller = make_controller(name, WorldConfig())
    flat = batch([make_state(seed, 12, 3) for seed in range(6)])
    grid = replace(flat, **{key: value.unflatten(0, (2, 3)) for key, value in vars(flat).items()})
    expected, _ = controller.act(flat, controller.begin(flat))
    result, memory = controller.act(grid, controller.begin(grid))
    assert torch.equal(result.flatten(0, 1), expected)
    assert all(value.shape[:2] == (2, 3) for value in memory.values())


@pytest.mark.parametrize('name', sorted(CONTROLLERS))
def test_no_controller_exceeds_the_top_speed_with_its_defaults_over_an_episode(name: str) -> None:
    world = WorldConfig(n_sheep=20, shepherd_speed=0.8)
    controller = make_controller(name, world)
    state = batch([make_state(seed, 20, 4, dtype=torch.float32) for seed in range(4)])
    memory = controller.begin(state)
    for _ in range(50):
        command, memory = controller.act(state, memory)
        assert (command.norm(dim=-1) <= 0.8 * (1 + 1e-6)).all()
        state = step(state, command, world)


@pytest.mark.parametrize('name', sorted(CONTROLLERS))
def test_the_commands_of_the_present_do_not_depend_on_the_absent(name: str) -> None:
    controller = make_controller(name, WorldConfig())
    state = make_state(4, 20, 3)
    more = padded(state, 3, 2)
    expected, _ = controller.act(state, controller.begin(state))
    result, _ = controller.act(more, controller.begin(more))
    assert_near(result[:3], expected, 1e-7)
    assert result.isfinite().all()


def test_places_on_an_arc_go_to_shepherds_in_order_of_bearing() -> None:
    around = torch.tensor([[0.3, -0.4, 0.1, 9.0], [0.0, 0.0, -1.0, 1.0]])
    mask = torch.tensor([[True, True, True, False], [True, True, True, True]])
    result = places_on_arc(around, torch.tensor([[0.5], [0.2]]), mask)
    assert_near(result[0, :3], [0.5, -0.5, 0.0], 1e-6)
    assert_near(result[1], [-0.1, 0.1, -0.3, 0.3], 1e-6)  # ties by index


def test_shepherds_on_the_far_side_part_and_keep_to_their_ways() -> None:
    # both a little left of the far point: in plain order of bearing the second would have to
    # cross over to the place on the right of the first
    spacing, mask = torch.tensor([0.8]), torch.tensor([True, True])
    near, far = torch.tensor([2.95, 3.12]), torch.tensor([2.80, -3.05])
    assert_near(places_on_arc(near, spacing, mask), [0.4, -0.4], 1e-6)
    assert_near(places_on_arc(far, spacing, mask), [0.4, -0.4], 1e-6)  # a step later
