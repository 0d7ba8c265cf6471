"""The Pierson controller: the arc's push and its inverse, places, and the slow reference."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
import math
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from reference import (
    arc_opening,
    arc_share,
    assert_near,
    batch,
    make_state,
    moved,
    padded,
    pierson_controller,
    state_of,
    turned,
    World,
)
from shepherd_ros.config import ConfigError
from shepherd_ros.controllers import make_controller
from shepherd_ros.controllers.controller import Memory
from shepherd_ros.controllers.pierson import opening_for, PiersonConfig, push_fraction
from shepherd_ros.sim.flocking.reynolds_flock import ReynoldsFlock
from shepherd_ros.sim.flocking.strombom_flock import StrombomFlock
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.transition import step
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor

DOUBLE = torch.float64
invariant = settings(max_examples=60, deadline=None, derandomize=True)
seeds = st.integers(0, 2**31)
angles = st.floats(-math.pi, math.pi)
teams = list(range(2, 21))


def act(
    state: WorldState, phi: Tensor | float, world: WorldConfig | None = None, **options: Any
) -> tuple[Tensor, Tensor]:
    """Return commands and the next heading of the flock."""
    controller = make_controller('pierson', world or WorldConfig(), **options)
    memory = remember(controller.begin(state), torch.as_tensor(phi, dtype=state.sheep.dtype))
    command, memory = controller.act(state, memory)
    assert command.shape == state.shepherds.shape
    assert command.dtype == state.shepherds.dtype
    return command, heading_in(memory)


def heading_in(memory: Memory) -> Tensor:
    (phi,) = memory.values()
    return phi


def remember(memory: Memory, phi: Tensor) -> Memory:
    (name,) = memory
    return {name: phi.expand_as(memory[name]).clone()}


def expected(
    state: WorldState, phi: float, world: WorldConfig | None = None, **options: Any
) -> tuple[np.ndarray, float]:
    world = world or WorldConfig()
    flock = world.flock
    # r_s of the paper where the flock has none of its own: not tuned again for Reynolds
    notice = getattr(flock, 'shepherd_range', 65 / 3)
    return pierson_controller(
        World.of(state),
        phi,
        PiersonConfig(**options),
        notice_range=notice,
        sheep_speed=flock.speed,
        top=world.shepherd_speed,
        dt=world.dt,
    )


def angle_between(a: Tensor, b: float) -> float:
    return abs(math.remainder(float(a) - b, 2 * math.pi))


def ring_state(seed: int, n: int, m: int) -> WorldState:
    rng = np.random.default_rng(seed)
    spread, reach = rng.choice([0.5, 2.0, 8.0]), rng.choice([5.0, 15.0, 40.0])
    return make_state(seed, n, m, spread=float(spread), reach=float(reach))


# --- the arc's push -----------------------------------------------------------------------------


def share(opening: float, m: int) -> float:
    return float(push_fraction(torch.tensor(opening, dtype=DOUBLE), torch.tensor(m)))


def opening(value: float, m: int) -> float:
    return float(opening_for(torch.tensor(value, dtype=DOUBLE), torch.tensor(m)))


def test_two_shepherds_push_with_the_cosine_of_half_the_opening() -> None:
    for delta in (0.0, 0.3, 1.0, 2.0, math.pi):
        assert share(delta, 2) == pytest.approx(math.cos(delta / 2), abs=1e-12)
    assert opening(0.5, 2) == pytest.approx(2 * math.pi / 3, abs=1e-5)
    assert opening(math.cos(0.25), 2) == pytest.approx(0.5, abs=1e-4)


def test_three_shepherds_push_with_a_third_of_one_and_two_cosines() -> None:
    # places at -Delta/2, 0 and Delta/2
    for delta in (0.2, 1.0, 2.0, 4.0):
        assert share(delta, 3) == pytest.approx((1 + 2 * math.cos(delta / 2)) / 3, abs=1e-12)
    assert opening(1 / 3, 3) == pytest.approx(math.pi, abs=1e-4)


def test_all_in_one_place_push_fully_and_an_even_ring_not_at_all() -> None:
    for m in teams:
        assert share(0.0, m) == pytest.approx(1.0)
        assert share(1e-9, m) == pytest.approx(1.0)
        assert share(2 * math.pi * (m - 1) / m, m) == pytest.approx(0.0, abs=1e-12)


def test_the_share_is_the_mean_cosine_over_the_arc() -> None:
    for m in teams:
        for delta in np.linspace(0.05, 2 * math.pi * (m - 1) / m, 9):
            places = [delta * (2 * j - m - 1) / (2 * m - 2) for j in range(1, m + 1)]
            assert share(delta, m) == pytest.approx(np.cos(places).mean(), abs=1e-12)


def test_the_opening_is_the_inverse_of_the_share() -> None:
    for m in teams:
        shares = np.linspace(0.01, 0.99, 99)
        openings = opening_for(torch.tensor(shares), torch.full((99,), m))
        assert_near(openings, [arc_opening(s, m) for s in shares], 2e-4)
        assert_near(push_fraction(openings, torch.full((99,), m)), shares, 2e-5)
        assert (openings.diff() < 0).all()
        again = opening_for(push_fraction(openings, torch.full((99,), m)), torch.full((99,), m))
        assert_near(again, openings, 4e-4)
        for delta in openings[::20].tolist():
            assert share(delta, m) == pytest.approx(arc_share(delta, m), abs=1e-12)


def test_openings_in_float32_are_those_of_float64() -> None:
    shares = torch.linspace(0.05, 0.95, 50)
    for m in (2, 3, 6, 20):
        team = torch.full((50,), m)
        single, double = opening_for(shares, team), opening_for(shares.double(), team)
        assert_near(single.double(), double, 2e-3)


# --- against the reference ----------------------------------------------------------------------


def test_commands_and_heading_are_those_of_the_reference() -> None:
    for n, m in product([1, 2, 10, 100], [1, 2, 3, 6, 20]):
        for seed in range(3):
            state = ring_state(100 * n + 10 * m + seed, n, m)
            phi = float(np.random.default_rng(seed).uniform(-3, 3))
            command, turned_to = expected(state, phi)
            for dtype, tolerance in ((torch.float64, 1e-4), (torch.float32, 2e-3)):
                result, got_phi = act(state.to(dtype), phi)
                assert_near(result, command, tolerance)
                assert angle_between(got_phi, turned_to) < 1e-5


def test_commands_for_a_thousand_sheep_are_those_of_the_reference() -> None:
    state = make_state(1, 1000, 8, spread=5.0, reach=50.0)
    assert_near(act(state, 0.4)[0], expected(state, 0.4)[0], 1e-4)


@pytest.mark.parametrize(
    'options',
    [
        {'assignment': 'fixed'},
        {'lead': 0.5},
        {'gain': 0.5, 'max_turn_rate': 0.1},
        {'gain': 0.0},
        {'weakest_push': 0.4, 'strongest_push': 0.6},
        {'spread_factor': 1.0, 'min_radius': 0.5},
        {'min_radius': 9.0},
        {'max_radius': 5.0},
        {'tracking_gain': 0.2},
        {'pace': 'constant'},
        {'pace': 'constant', 'assignment': 'fixed', 'tracking_gain': 0.2},
    ],
    ids=str,
)
def test_every_option_is_that_of_the_reference(options: dict[str, Any]) -> None:
    for flock, dt in product([StrombomFlock(), ReynoldsFlock()], [0.1, 1.0]):
        world = WorldConfig(dt=dt, shepherd_speed=1.5, flock=flock)
        for seed, m in product(range(4), (1, 2, 5)):
            state = ring_state(seed, 12, m)
            result, phi = act(state, 0.3 * seed, world, **options)
            command, turned_to = expected(state, 0.3 * seed, world, **options)
            assert_near(result, command, 1e-4)
            assert angle_between(phi, turned_to) < 1e-9


# --- by hand ------------------------------------------------------------------------------------


def places(state: WorldState, phi: float, **options: Any) -> Tensor:
    """Return where the shepherds go: read from commands that reach it in one step."""
    world = WorldConfig(shepherd_speed=1e6, dt=1.0, **options)
    return state.shepherds + act(state, phi, world, tracking_gain=1.0, gain=0.0)[0]


def four_sheep(x: float, y: float, size: float) -> list[list[float]]:
    """Return a cross of sheep about (x, y), whose spread is its size."""
    return [[x + size, y], [x - size, y], [x, y + size], [x, y - size]]


def test_a_single_shepherd_stands_opposite_to_the_goal_three_spreads_behind() -> None:
    state = state_of(four_sheep(10.0, 0.0, 2.0), [[30.0, 5.0]])
    for phi in (0.0, 2.0):
        assert_near(places(state, phi), [[16.0, 0.0]], 1e-9)


def test_two_shepherds_stand_even_about_the_line_behind_the_flock() -> None:
    # without gain the push is the weakest, 0.15 = cos(Delta / 2): 81.4 degrees to either side
    state = state_of(four_sheep(0.0, 0.0, 2.0), [[9.0, 5.0], [9.0, -5.0]], goal=[-50.0, 0.0])
    x, y = 6 * 0.15, 6 * math.sqrt(1 - 0.15**2)
    assert_near(places(state, math.pi), [[x, y], [x, -y]], 1e-3)


def test_three_shepherds_stand_with_one_in_the_middle() -> None:
    # (1 + 2 cos) / 3 = 0.15: cos = -0.275
    shepherds = [[0.0, -9.0], [9.0, 0.0], [0.0, 9.0]]
    state = state_of(four_sheep(0.0, 0.0, 2.0), shepherds, goal=[-50.0, 0.0])
    x, y = -6 * 0.275, 6 * math.sqrt(1 - 0.275**2)
    assert_near(places(state, math.pi), [[x, -y], [6.0, 0.0], [x, y]], 1e-3)


def test_the_radius_stays_between_its_bounds() -> None:
    for size, flock, radius in (
        (0.1, StrombomFlock(), 4.0),
        (1.5, StrombomFlock(), 4.5),
        (9.0, StrombomFlock(), 0.75 * 65 / 3),
        (9.0, StrombomFlock(shepherd_range=12.0), 9.0),
        (9.0, ReynoldsFlock(), 0.75 * 65 / 3),
    ):
        state = state_of(four_sheep(100.0, 0.0, size), [[130.0, 5.0]])
        assert_near(places(state, 0.0, flock=flock), [[100.0 + radius, 0.0]], 1e-9)


def test_sorted_places_leave_no_crossing_and_fixed_ones_go_by_number() -> None:
    state = state_of(four_sheep(0.0, 0.0, 2.0), [[9.0, 5.0], [9.0, -5.0]], goal=[-50.0, 0.0])
    swapped = replace(state, shepherds=state.shepherds.flip(0))
    assert_near(places(swapped, math.pi), places(state, math.pi).flip(0), 1e-9)
    world = WorldConfig(shepherd_speed=1e6, dt=1.0)
    options = {'tracking_gain': 1.0, 'gain': 0.0, 'assignment': 'fixed'}
    directions = [s.shepherds + act(s, math.pi, world, **options)[0] for s in (state, swapped)]
    assert_near(directions[0], directions[1], 1e-9)
    # places go counter-clockwise: the first is at the lesser angle
    assert directions[0][0, 1] < 0 < directions[0][1, 1]


def test_the_first_heading_points_from_the_flock_to_the_goal() -> None:
    controller = make_controller('pierson', WorldConfig())
    state = state_of(four_sheep(3.0, 4.0, 1.0), [[9.0, 9.0]], goal=[0.0, 0.0])
    phi = heading_in(controller.begin(state))
    assert angle_between(phi, math.atan2(-4.0, -3.0)) < 1e-12


def test_the_heading_turns_as_the_lead_point_wants_but_not_too_fast() -> None:
    # lead point (2, 0), goal (0, 10): omega = -k / l (p - g) . (0, 1) = 10 k / l
    state = state_of(four_sheep(0.0, 0.0, 1.0), [[9.0, 9.0]], goal=[0.0, 10.0])
    assert_near(act(state, 0.0)[1], 0.5 * 0.05 / 2 * 10, 1e-12)
    assert_near(act(state, 0.0, gain=1.0)[1], 0.5 * 0.5, 1e-12)
    assert_near(act(state, 0.0, gain=1.0, max_turn_rate=2.0)[1], 0.5 * 2.0, 1e-12)
    behind = replace(state, goal=torch.tensor([0.0, -10.0], dtype=DOUBLE))
    assert angle_between(act(behind, 0.0, gain=1.0)[1], -0.25) < 1e-12


def test_a_flock_that_heads_for_the_goal_goes_straight_on_and_is_pushed_hard() -> None:
    # lead point 48 m before the goal: v = 0.05 * 48 = 2.4 m/s, 7.2 sheep speeds: strongest push
    state = state_of(four_sheep(0.0, 0.0, 2.0), [[9.0, 5.0], [9.0, -5.0]], goal=[-50.0, 0.0])
    world = WorldConfig(shepherd_speed=1e6, dt=1.0)
    command, phi = act(state, math.pi, world, tracking_gain=1.0)
    assert angle_between(phi, math.pi) < 1e-9
    x, y = 6 * 0.9, 6 * math.sqrt(1 - 0.81)
    assert_near(state.shepherds + command, [[x, y], [x, -y]], 1e-3)


def test_tracking_goes_part_of_the_way_in_a_step() -> None:
    state = state_of(four_sheep(10.0, 0.0, 2.0), [[16.1, 0.0]])  # place: (16, 0)
    for dt, gain in ((1.0, 1.0), (0.5, 2.0), (0.1, 2.0), (4.0, 0.25)):
        world = WorldConfig(dt=dt)
        assert_near(act(state, 0.0, world)[0], [[-0.1 * gain, 0.0]], 1e-9)
    assert_near(act(state, 0.0, tracking_gain=5.0)[0], [[-0.5, 0.0]], 1e-9)


# --- invariants ---------------------------------------------------------------------------------


@invariant
@given(seeds, angles, st.integers(1, 40), st.integers(1, 20), st.floats(0.0, 3.0))
def test_no_command_is_faster_than_the_top_speed(
    seed: int, phi: float, n: int, m: int, top: float
) -> None:
    world = WorldConfig(shepherd_speed=top)
    for dtype in (torch.float64, torch.float32):
        command, _ = act(ring_state(seed, n, m).to(dtype), phi, world)
        assert command.isfinite().all()
        assert (command.norm(dim=-1) <= top * (1 + 1e-6)).all()


@invariant
@given(
    seeds,
    angles,
    angles,
    st.tuples(st.floats(-100, 100), st.floats(-100, 100)),
    st.integers(1, 40),
    st.integers(1, 8),
)
def test_commands_turn_with_the_world_and_do_not_depend_on_where_it_is(
    seed: int, phi: float, angle: float, shift: tuple[float, float], n: int, m: int
) -> None:
    state = ring_state(seed, n, m)
    command, heading = act(state, phi)
    result, got_heading = act(moved(state, angle, shift), phi + angle)
    assert_near(result, turned(command, math.cos(angle), math.sin(angle)), 1e-6)
    assert angle_between(got_heading, float(heading) + angle) < 1e-9


def test_a_batch_equals_each_world_alone_bit_for_bit_with_its_memory() -> None:
    controller = make_controller('pierson', WorldConfig())
    for dtype in (torch.float32, torch.float64):
        states = [ring_state(seed, 30, 4).to(dtype) for seed in range(8)]
        together = batch(states)
        memory = controller.begin(together)
        memories = [controller.begin(state) for state in states]
        for _ in range(20):
            commands, memory = controller.act(together, memory)
            together = step(together, commands, WorldConfig())
            for index, state in enumerate(states):
                command, memories[index] = controller.act(state, memories[index])
                assert torch.equal(commands[index], command)
                states[index] = step(state, command, WorldConfig())
        for index in range(8):
            assert torch.equal(heading_in(memory)[index], heading_in(memories[index]))


def test_mixed_flock_and_team_sizes_in_one_batch_equal_each_alone() -> None:
    # sums over more places may round differently, so the bound is not zero
    sizes = [(1, 1), (2, 6), (30, 20), (100, 3), (17, 2), (30, 1)]
    states = [ring_state(seed, n, m) for seed, (n, m) in enumerate(sizes)]
    together, phi = act(batch(states), 0.7)
    assert together.isfinite().all()
    for index, state in enumerate(states):
        command, alone = act(state, 0.7)
        assert_near(together[index, : len(state.shepherds)], command, 1e-7)
        assert_near(phi[index], alone, 1e-9)


@invariant
@given(seeds, st.integers(1, 30), st.integers(1, 6), st.integers(0, 5), st.integers(0, 5))
def test_absent_sheep_and_shepherds_influence_nothing(
    seed: int, n: int, m: int, more_sheep: int, more_shepherds: int
) -> None:
    state = ring_state(seed, n, m)
    state = replace(state, goal=state.center + 0.1)
    for assignment in ('sorted', 'fixed'):
        command, phi = act(padded(state, more_sheep, more_shepherds), 0.3, assignment=assignment)
        alone, alone_phi = act(state, 0.3, assignment=assignment)
        assert_near(command[:m], alone, 1e-7)
        assert_near(phi, alone_phi, 1e-9)
        assert command.isfinite().all()


def test_a_flock_may_be_degenerate() -> None:
    point = torch.tensor([1.5, -2.0], dtype=DOUBLE)
    base = make_state(1, 1000, 20)
    worlds = {
        'one point': replace(base, sheep=point.expand(1000, 2)),
        'everyone in one point': replace(
            base, sheep=point.expand(1000, 2), shepherds=point.expand(20, 2), goal=point
        ),
        'on sheep': replace(base, shepherds=base.sheep[:20]),
        'goal on the center': replace(base, goal=base.center),
        'shepherds on the center': replace(base, shepherds=base.center.expand(20, 2)),
        'one of each': state_of([[1.0, 1.0]], [[1.0, 1.0]]),
        'one of each on the goal': state_of([[0.0, 0.0]], [[0.0, 0.0]]),
    }
    for name, state in worlds.items():
        for dtype in (torch.float32, torch.float64):
            for flock in (StrombomFlock(), ReynoldsFlock(), StrombomFlock(speed=0.0)):
                world = WorldConfig(flock=flock)
                controller = make_controller('pierson', world)
                seen = state.to(dtype)
                command, memory = controller.act(seen, controller.begin(seen))
                assert command.isfinite().all(), name
                assert heading_in(memory).isfinite().all(), name
                assert (command.norm(dim=-1) <= 1 + 1e-6).all(), name


def test_shares_of_the_push_are_within_one() -> None:
    for name in ('weakest_push', 'strongest_push'):
        with pytest.raises(ConfigError, match=rf'{name} is 1.5: expected a value in'):
            PiersonConfig(**{name: 1.5})
