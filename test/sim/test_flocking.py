"""The flocks' laws of motion: against the slow reference, and the invariants that they keep."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
import math
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
import pytest
from reference import (
    assert_near,
    assert_same_world,
    batch,
    make_state,
    moved,
    padded,
    reynolds_flock,
    state_of,
    strombom_flock,
    turned,
    World,
)
from shepherd_ros.config import ConfigError
from shepherd_ros.sim.flocking import FLOCK_MODELS, model_of
from shepherd_ros.sim.flocking.reynolds_flock import ReynoldsFlock
from shepherd_ros.sim.flocking.strombom_flock import StrombomFlock
from shepherd_ros.sim.rng import direction, normal, Stream, uniform
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.transition import finite_command, step
from shepherd_ros.sim.vectors import from_bearing
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor

QUIET = StrombomFlock(noise=0.0, graze_probability=0.0)
RAW = ReynoldsFlock(terms='raw')
FLOCKS = [QUIET, ReynoldsFlock(), RAW]
NOISY_FLOCKS = [StrombomFlock(graze_probability=0.5), ReynoldsFlock()]
REFERENCES = {StrombomFlock: strombom_flock, ReynoldsFlock: reynolds_flock}
invariant = settings(max_examples=40, deadline=None, derandomize=True)
seeds = st.integers(0, 2**31)
angles = st.floats(-math.pi, math.pi)
shifts = st.tuples(st.floats(-100, 100), st.floats(-100, 100))
DTYPES = (torch.float32, torch.float64)
flock_ids = [type(f).__name__ for f in NOISY_FLOCKS]


def flock_step(state: WorldState, config: Any, dt: float = 0.5) -> tuple[Tensor, Tensor]:
    return model_of(config).step(state, config, dt)


def reacts(state: WorldState, config: StrombomFlock) -> Tensor:
    apart = torch.cdist(state.sheep.double(), state.shepherds.double())
    return (apart < config.shepherd_range).any(dim=-1)


def assert_is_the_reference(state: WorldState, config: Any, dt: float = 0.5) -> None:
    """Compare in both precisions: the same world, 1e-4 in float32 and 1e-7 in float64."""
    expected = REFERENCES[type(config)](World.of(state), config, dt)
    for dtype, tolerance in ((torch.float64, 1e-7), (torch.float32, 1e-4)):
        sheep, heading = flock_step(state.to(dtype), config, dt)
        assert sheep.dtype == heading.dtype == dtype
        assert_near(sheep, expected[0], tolerance)
        assert_near(heading, expected[1], tolerance)


# --- against the reference ----------------------------------------------------------------------


def test_a_strombom_step_is_the_reference() -> None:
    for n, m in product([1, 2, 3, 10, 100], [1, 2, 3, 6, 20]):
        for seed, (spread, reach) in enumerate([(4.0, 25.0), (1.0, 8.0), (15.0, 60.0)]):
            state = make_state(1000 * n + 10 * m + seed, n, m, spread=spread, reach=reach)
            assert_is_the_reference(state, StrombomFlock(graze_probability=0.5), dt=0.5)


def test_every_switch_of_the_strombom_step_is_the_reference() -> None:
    for config in [
        StrombomFlock(normalize_shepherds=True),
        StrombomFlock(metric_attraction=True, sheep_range=10.0),
        StrombomFlock(normalize_shepherds=True, metric_attraction=True),
        StrombomFlock(n_neighbors=1),
        StrombomFlock(n_neighbors=7),
        StrombomFlock(n_neighbors=28),
        StrombomFlock(n_neighbors=29),
        StrombomFlock(n_neighbors=30),
        StrombomFlock(n_neighbors=500),
        StrombomFlock(sheep_range=0.0),
        StrombomFlock(sheep_range=10.0, sheep_repulsion=4.0),
        StrombomFlock(shepherd_range=0.0, graze_probability=1.0),
        StrombomFlock(cohesion=0.0, inertia=0.0, noise=0.0),
        StrombomFlock(speed=0.0),
    ]:
        for seed in range(4):
            assert_is_the_reference(make_state(seed, 30, 3), config, dt=1.0)


@pytest.mark.parametrize('n_neighbors', [90, 700, 999])
def test_a_strombom_step_of_a_thousand_sheep_is_the_reference(n_neighbors: int) -> None:
    state = make_state(n_neighbors, 1000, 4, spread=12.0, reach=40.0)
    config = StrombomFlock(graze_probability=0.3, n_neighbors=n_neighbors)
    reacting = reacts(state, config)
    assert reacting.any()
    assert not reacting.all()
    assert_is_the_reference(state, config)


def test_a_reynolds_step_is_the_reference() -> None:
    for terms, n, m in product(['unit', 'raw'], [1, 2, 3, 10, 100], [1, 2, 3, 6, 20]):
        for seed, (spread, reach) in enumerate([(4.0, 25.0), (1.0, 8.0), (15.0, 60.0)]):
            state = make_state(1000 * n + 10 * m + seed, n, m, spread=spread, reach=reach)
            assert_is_the_reference(state, ReynoldsFlock(terms=terms), dt=0.5)


def test_every_option_of_the_reynolds_step_is_the_reference() -> None:
    for config in [
        ReynoldsFlock(view_range=0.0),
        ReynoldsFlock(view_range=1000.0, max_acceleration=0.05),
        ReynoldsFlock(max_acceleration=1000.0),
        ReynoldsFlock(max_acceleration=0.0),
        ReynoldsFlock(min_distance=2.0, separation=4.0),
        ReynoldsFlock(alignment=0.0, cohesion=3.0),
        ReynoldsFlock(fear=0.0),
        ReynoldsFlock(speed=1.5),
        replace(RAW, max_acceleration=1000.0),
        replace(RAW, min_distance=2.0, separation=4.0),
    ]:
        for seed in range(4):
            assert_is_the_reference(make_state(seed, 30, 3), config, dt=1.0)


def test_a_reynolds_step_of_a_thousand_sheep_is_the_reference() -> None:
    assert_is_the_reference(make_state(5, 1000, 4, spread=12.0, reach=20.0), ReynoldsFlock())


def test_twenty_steps_of_a_world_are_twenty_steps_of_the_reference() -> None:
    for n, config in product([1, 2, 30], NOISY_FLOCKS):
        state = make_state(n, n, 3, reach=24.0)
        command = torch.tensor([[0.3, 0.1], [-2.0, 0.4], [0.0, -0.9]], dtype=torch.float64)
        world = World.of(state)
        for _ in range(20):
            state = step(state, command, WorldConfig(flock=config))
            velocity = command.numpy() / [[1], [math.hypot(2.0, 0.4)], [1]]
            world = replace(world, shepherds=world.shepherds + 0.5 * velocity)
            sheep, heading = REFERENCES[type(config)](world, config, 0.5)
            world = replace(world, step=world.step + 1, sheep=sheep, heading=heading)
        assert int(state.step) == world.step
        assert_near(state.shepherds, world.shepherds, 1e-9)
        assert_near(state.sheep, world.sheep, 1e-7)


# --- by hand ------------------------------------------------------------------------------------


def test_a_lone_sheep_flees_straight_away_along_the_three_four_five_triangle() -> None:
    state = state_of([[3.0, 4.0]], [[0.0, 0.0]], heading=[[0.6, 0.8]])
    sheep, heading = flock_step(state, replace(QUIET, speed=1.0), dt=5.0)
    assert_near(sheep, [[6.0, 8.0]], 1e-12)
    assert_near(heading, [[0.6, 0.8]], 1e-12)


def test_the_pushes_of_two_shepherds_add_up_unless_they_are_normalized() -> None:
    state = state_of([[0.0, 0.0]], [[-1.0, 0.0], [-2.0, 0.0]], heading=[[0.0, 1.0]])
    plain = replace(QUIET, inertia=1.0)
    assert_near(flock_step(state, plain)[1], [[2 / 5**0.5, 1 / 5**0.5]], 1e-12)
    together = replace(plain, normalize_shepherds=True)
    assert_near(flock_step(state, together)[1], [[0.5**0.5, 0.5**0.5]], 1e-12)


def test_a_shepherd_at_exactly_the_range_is_not_noticed() -> None:
    config = replace(QUIET, shepherd_range=10.0)
    state = state_of([[0.0, 0.0]], [[-10.0, 0.0]])
    assert_near(flock_step(state, config)[0], [[0.0, 0.0]], 0.0)
    nearer = state_of([[0.0, 0.0]], [[-9.999, 0.0]])
    assert_near(flock_step(nearer, config)[0], [[1 / 6, 0.0]], 1e-7)


def test_attraction_goes_to_the_mean_of_the_nearest_sheep_only() -> None:
    sheep = [[0.0, 0.0], [2.0, 0.0], [0.0, 3.0], [-40.0, 0.0]]
    config = StrombomFlock(
        n_neighbors=2, inertia=0.0, noise=0.0, shepherd_repulsion=0.0, sheep_range=0.0
    )
    _, heading = flock_step(state_of(sheep, [[0.0, -1.0]]), config)
    assert_near(heading[0], [2 / 13**0.5, 3 / 13**0.5], 1e-12)


def test_metric_attraction_grows_with_the_distance() -> None:
    config = StrombomFlock(
        metric_attraction=True, cohesion=0.5, inertia=1.0, noise=0.0, shepherd_repulsion=0.0
    )
    state = state_of([[0.0, 0.0], [6.0, 0.0]], [[0.0, -1.0]], heading=[[0.0, 1.0], [0.0, 1.0]])
    _, heading = flock_step(state, config)
    assert_near(heading[0], [3 / 10**0.5, 1 / 10**0.5], 1e-12)


def test_forces_that_cancel_leave_the_heading_as_it_is() -> None:
    shepherds = [[-1.0, 0.0], [1.0, 0.0]]
    config = replace(QUIET, inertia=0.0)
    state = state_of([[0.0, 0.0]], shepherds, heading=[[0.0, 1.0]])
    sheep, heading = flock_step(state, config)
    assert_near(heading, [[0.0, 1.0]], 0.0)
    assert_near(sheep, [[0.0, 1 / 6]], 1e-7)


def test_a_lone_reynolds_sheep_goes_straight_on() -> None:
    sheep, heading = flock_step(state_of([[0.0, 0.0]], [[8.0, 0.0]]), ReynoldsFlock(), dt=3.0)
    assert_near(sheep, [[1.0, 0.0]], 1e-12)
    assert_near(heading, [[1.0, 0.0]], 0.0)


def test_fear_of_reynolds_sheep_is_cut_to_the_greatest_acceleration() -> None:
    # raw fear 10 / 5 = 2 m/s2 across the way, cut to 1/3: velocity (1/3, 1/3 dt)
    state = state_of([[0.0, 0.0]], [[0.0, -5.0]])
    for config in (RAW, ReynoldsFlock()):
        _, heading = flock_step(state, config, dt=0.5)
        assert_near(heading, [[2 / 5**0.5, 1 / 5**0.5]], 1e-12)
    # 0.1 / 5 = 0.02 m/s2 stays as it is, and so does 0.1 m/s2, the weight of a direction
    for config, fear in [(replace(RAW, fear=0.1), 0.02), (ReynoldsFlock(fear=0.1), 0.1)]:
        _, heading = flock_step(state, config, dt=0.5)
        assert_near(heading[0, 1] / heading[0, 0], fear * 0.5 * 3, 1e-12)


def test_directions_of_reynolds_terms_by_hand() -> None:
    # one neighbour 2 m ahead, heading across; no shepherd near: separation is -x, cohesion +x,
    # alignment (0, 1) - (1, 0)
    state = state_of([[0.0, 0.0], [2.0, 0.0]], [[50.0, 0.0]], heading=[[1.0, 0.0], [0.0, 1.0]])
    config = ReynoldsFlock(separation=2.0, alignment=0.3, cohesion=1.5, max_acceleration=9.0)
    _, heading = flock_step(state, config, dt=0.1)
    # velocity (1/3, 0) + 0.1 (-2 - 0.3 + 1.5, 0.3)
    wanted = torch.tensor([1 / 3 - 0.08, 0.03], dtype=torch.float64)
    assert_near(heading[0], wanted / wanted.norm(), 1e-12)


# --- how far sheep move -------------------------------------------------------------------------


@invariant
@given(seeds, st.integers(1, 40), st.integers(1, 8), st.floats(0.01, 2.0), st.floats(0.0, 2.0))
def test_a_reacting_sheep_moves_exactly_its_speed_times_dt_and_a_grazing_one_that_or_nothing(
    seed: int, n: int, m: int, dt: float, speed: float
) -> None:
    config = StrombomFlock(speed=speed, graze_probability=0.5)
    state = make_state(seed, n, m, spread=8.0, reach=40.0)
    sheep, heading = flock_step(state, config, dt)
    displacement = (sheep - state.sheep).norm(dim=-1)
    reacting = reacts(state, config)
    assert_near(displacement[reacting], torch.full_like(displacement[reacting], speed * dt), 1e-6)
    grazing = displacement[~reacting]
    assert ((grazing == 0) | ((grazing - speed * dt).abs() < 1e-6)).all()
    assert_near(heading.norm(dim=-1), torch.ones(n), 1e-6)


@invariant
@given(seeds, st.integers(1, 40), st.integers(1, 8), st.floats(0.01, 2.0))
def test_a_reynolds_sheep_always_moves_exactly_its_speed_times_dt(
    seed: int, n: int, m: int, dt: float
) -> None:
    state = make_state(seed, n, m)
    sheep, _ = flock_step(state, ReynoldsFlock(), dt)
    displacement = (sheep - state.sheep).norm(dim=-1)
    assert_near(displacement, torch.full((n,), dt / 3), 1e-7)


def test_a_grazing_sheep_keeps_its_heading_or_takes_the_drawn_one() -> None:
    state = make_state(3, 200, 1, spread=1.0)
    state = replace(state, shepherds=state.sheep[:1] + 100.0)
    sheep, heading = flock_step(state, StrombomFlock(graze_probability=0.3))
    index = torch.arange(200)
    moving = uniform(state.seed, state.step, Stream.GRAZE, index) < 0.3
    drawn = direction(state.seed, state.step, Stream.TURN, index, torch.float64)
    assert 0.15 < moving.float().mean() < 0.45
    assert torch.equal(sheep[~moving], state.sheep[~moving])
    assert torch.equal(heading[~moving], state.heading[~moving])
    assert_near(heading[moving], drawn[moving], 1e-12)
    assert_near(sheep[moving], (state.sheep + drawn / 6)[moving], 1e-7)


def test_speed_times_dt_is_exact_in_float64() -> None:
    for config in (StrombomFlock(), ReynoldsFlock()):
        state = make_state(4, 50, 3, spread=2.0, reach=5.0)
        heading = state.heading / state.heading.norm(dim=-1, keepdim=True)
        sheep, _ = flock_step(replace(state, heading=heading), config, 0.5)
        displacement = (sheep - state.sheep).norm(dim=-1)
        assert_near(displacement, torch.full((50,), 1 / 6, dtype=torch.float64), 1e-12)


# --- symmetries ---------------------------------------------------------------------------------


@invariant
@given(seeds, angles, shifts, st.integers(1, 40), st.integers(1, 6), st.sampled_from(FLOCKS))
def test_a_step_of_the_turned_and_shifted_world_is_the_turned_and_shifted_step(
    seed: int, angle: float, shift: tuple[float, float], n: int, m: int, config: Any
) -> None:
    state = make_state(seed, n, m)
    world = WorldConfig(flock=config)
    command = 0.4 * state.heading[:1].expand(m, 2)
    c, s = math.cos(angle), math.sin(angle)
    expected = moved(step(state, command, world), angle, shift)
    result = step(moved(state, angle, shift), turned(command, c, s), world)
    assert_near(result.sheep, expected.sheep, 1e-7)
    assert_near(result.heading, expected.heading, 1e-7)
    assert_near(result.shepherds, expected.shepherds, 1e-7)


@invariant
@given(seeds, st.integers(2, 30), st.sampled_from(FLOCKS))
def test_the_order_of_sheep_and_of_shepherds_does_not_matter(
    seed: int, n: int, config: Any
) -> None:
    state = make_state(seed, n, 4)
    order, team = torch.randperm(n, generator=torch.Generator().manual_seed(seed)), [2, 0, 3, 1]
    shuffled = replace(
        state,
        sheep=state.sheep[order],
        heading=state.heading[order],
        shepherds=state.shepherds[team],
    )
    expected, result = flock_step(state, config), flock_step(shuffled, config)
    assert_near(result[0], expected[0][order], 1e-9)
    assert_near(result[1], expected[1][order], 1e-9)


# --- degenerate worlds --------------------------------------------------------------------------


def degenerate_worlds() -> dict[str, WorldState]:
    apart = make_state(1, 20, 20)
    one_point = torch.tensor([17.3, -4.2], dtype=torch.float64)
    crowd = make_state(3, 1000, 3)
    crowd = replace(crowd, sheep=one_point.expand(1000, 2), shepherds=crowd.shepherds * 0.2)
    return {
        'one sheep, one shepherd': make_state(2, 1, 1, reach=10.0),
        'one sheep under its shepherd': state_of([[1.5, 2.0]], [[1.5, 2.0]]),
        'all sheep in one point': replace(apart, sheep=one_point.expand(20, 2)),
        'a thousand sheep in one point': crowd,
        'all sheep and shepherds in one point': replace(
            apart, sheep=one_point.expand(20, 2), shepherds=one_point.expand(20, 2)
        ),
        'shepherds exactly on sheep': replace(apart, shepherds=apart.sheep),
        'shepherds in one point': replace(apart, shepherds=apart.shepherds[:1].expand(20, 2)),
        'goal exactly on the center': replace(apart, goal=apart.center),
        'sheep in a row with equal gaps': state_of(
            [[float(k), 0.0] for k in range(5)], [[2.0, 0.0]]
        ),
    }


@pytest.mark.parametrize('config', NOISY_FLOCKS + FLOCKS, ids=str)
def test_a_degenerate_world_stays_finite_and_its_headings_unit_vectors(config: Any) -> None:
    for (name, world), dtype in product(degenerate_worlds().items(), DTYPES):
        state = world.to(dtype)
        for _ in range(3):
            state = step(state, torch.zeros_like(state.shepherds), WorldConfig(flock=config))
        assert state.sheep.isfinite().all(), name
        assert_near(state.heading.norm(dim=-1), torch.ones(len(state.heading)), 1e-5)


@pytest.mark.parametrize('config', NOISY_FLOCKS, ids=flock_ids)
def test_a_step_of_a_degenerate_world_is_the_reference(config: Any) -> None:
    for world, dtype in product(degenerate_worlds().values(), DTYPES):
        state = world.to(torch.float32).to(dtype)
        expected = REFERENCES[type(config)](World.of(state), config, 0.5)
        for result, wanted in zip(flock_step(state, config), expected, strict=True):
            assert_near(result, wanted, 1e-7 if dtype == torch.float64 else 1e-4)


def test_sheep_in_one_point_do_not_attract_each_other_wherever_it_is() -> None:
    for n, point in product([3, 7, 120], [[0.0, 0.0], [10.1, -3.3], [-33.3, 27.7]]):
        for dtype in (torch.float64, torch.float32):
            state = state_of([point] * n, [[point[0] - 5.0, point[1]]]).to(dtype)
            _, heading = flock_step(state, QUIET)
            assert_near(heading, [[1.0, 0.0]] * n, 1e-5)  # away from the shepherd, and straight on


# --- commands -----------------------------------------------------------------------------------


@invariant
@given(
    st.lists(st.tuples(st.floats(width=32), st.floats(width=32)), min_size=1, max_size=5),
    st.floats(0.0, 3.0),
)
def test_no_command_moves_a_shepherd_faster_than_its_top_speed(
    commands: list[tuple[float, float]], top: float
) -> None:
    state = state_of([[50.0, 50.0]], torch.zeros(len(commands), 2))
    config = WorldConfig(shepherd_speed=top, dt=0.5)
    for dtype in (torch.float64, torch.float32):
        command = torch.tensor(commands, dtype=dtype)
        moved_by = step(state.to(dtype), command, config).shepherds
        assert moved_by.isfinite().all()
        assert (moved_by.norm(dim=-1) <= top * 0.5 * (1 + 1e-6)).all()


def test_a_command_with_a_non_finite_part_counts_as_zero() -> None:
    for bad, axis in product([math.nan, math.inf, -math.inf], [0, 1]):
        state = make_state(4, 10, 3)
        command = torch.tensor([[0.5, 0.5], [0.3, -0.2], [0.1, 0.9]], dtype=torch.float64)
        broken, zeroed = command.clone(), command.clone()
        broken[1, axis], zeroed[1] = bad, 0.0
        assert finite_command(broken).tolist() == [True, False, True]
        assert_same_world(step(state, broken, WorldConfig()), step(state, zeroed, WorldConfig()))


def test_a_command_is_cut_to_the_top_speed_with_its_direction_kept() -> None:
    state = state_of([[50.0, 50.0]], [[0.0, 0.0], [0.0, 0.0]])
    after = step(
        state, torch.tensor([[30.0, 40.0], [0.3, 0.4]], dtype=torch.float64), WorldConfig(dt=0.5)
    )
    assert_near(after.shepherds, [[0.3, 0.4], [0.15, 0.2]], 1e-12)


def test_sheep_answer_to_where_the_shepherds_go_in_the_same_step() -> None:
    world = WorldConfig(flock=replace(QUIET, shepherd_range=10.0), dt=0.5)
    state = state_of([[0.0, 0.0]], [[-10.2, 0.0]])
    stays = step(state, torch.zeros(1, 2).double(), world)
    assert_near(stays.sheep, [[0.0, 0.0]], 0.0)
    comes = step(state, torch.tensor([[1.0, 0.0]]).double(), world)
    assert_near(comes.sheep, [[1 / 6, 0.0]], 1e-7)
    assert int(comes.step) == 1


def test_a_step_leaves_goal_seed_and_masks_alone() -> None:
    state = padded(make_state(4, 10, 3), 2, 2)
    after = step(state, torch.zeros_like(state.shepherds), WorldConfig())
    for name in ('seed', 'goal', 'goal_radius', 'sheep_mask', 'shepherd_mask'):
        assert torch.equal(getattr(after, name), getattr(state, name))


# --- masks and batches --------------------------------------------------------------------------


def test_absent_sheep_and_shepherds_influence_nothing_and_move_nowhere() -> None:
    for config, sizes in product(NOISY_FLOCKS, [(30, 3), (1, 1), (95, 2)]):
        # sums over more places may round differently, so the bound is not zero
        n, m = sizes
        world = WorldConfig(flock=config)
        alone = make_state(6, n, m)
        alone = replace(alone, goal=alone.center)  # the absent stand in the middle of the flock
        with_absent = padded(alone, 7, 4)
        command = torch.full((m + 4, 2), 0.5, dtype=torch.float64)
        for _ in range(20):
            alone = step(alone, command[:m], world)
            with_absent = step(with_absent, command, world)
        assert_near(with_absent.sheep[:n], alone.sheep, 1e-7)
        assert_near(with_absent.heading[:n], alone.heading, 1e-7)
        assert_near(with_absent.shepherds[:m], alone.shepherds, 1e-7)
        assert torch.equal(with_absent.sheep[n:], alone.goal.expand(7, 2))
        assert torch.equal(with_absent.shepherds[m:], alone.goal.expand(4, 2))
        assert with_absent.heading.isfinite().all()


@pytest.mark.parametrize('config', NOISY_FLOCKS, ids=flock_ids)
@pytest.mark.parametrize('dtype', [torch.float32, torch.float64], ids=str)
def test_a_batch_of_worlds_equals_each_world_alone_bit_for_bit_over_twenty_steps(
    config: Any, dtype: torch.dtype
) -> None:
    world = WorldConfig(flock=config)
    alone = [make_state(seed, 40, 3, dtype=dtype) for seed in range(6)]
    together = batch(alone)
    command = torch.tensor([[0.3, 0.1], [-0.5, 0.4], [0.0, -0.9]], dtype=dtype)
    for _ in range(20):
        together = step(together, command.expand(6, 3, 2), world)
        alone = [step(state, command, world) for state in alone]
    for index, state in enumerate(alone):
        assert_same_world(together.world(index), state)


@pytest.mark.parametrize('config', NOISY_FLOCKS, ids=flock_ids)
def test_worlds_of_mixed_sizes_in_one_batch_equal_each_alone(config: Any) -> None:
    # sums over more places may round differently, so the bound is not zero
    world = WorldConfig(flock=config)
    sizes = [(1, 1), (2, 20), (40, 3), (100, 6), (7, 2)]
    alone = [make_state(n, n, m) for n, m in sizes]
    together = batch(alone)
    command = torch.tensor([0.3, -0.4], dtype=torch.float64)
    for _ in range(20):
        together = step(together, command.expand(5, 20, 2), world)
        alone = [step(s, command.expand(len(s.shepherds), 2), world) for s in alone]
    for index, (n, m) in enumerate(sizes):
        assert_near(together.sheep[index, :n], alone[index].sheep, 1e-6)
        assert_near(together.shepherds[index, :m], alone[index].shepherds, 1e-6)


def test_any_number_of_leading_axes_is_a_batch() -> None:
    states = [make_state(seed, 12, 2) for seed in range(6)]
    flat = batch(states)
    grid = replace(
        flat,
        **{name: getattr(flat, name).unflatten(0, (2, 3)) for name in vars(flat)},
    )
    command = torch.zeros_like(flat.shepherds)
    expected = step(flat, command, WorldConfig())
    result = step(grid, command.unflatten(0, (2, 3)), WorldConfig())
    assert torch.equal(result.sheep.flatten(0, 1), expected.sheep)


@pytest.mark.parametrize('config', NOISY_FLOCKS, ids=flock_ids)
def test_float32_follows_float64_over_twenty_steps(config: Any) -> None:
    double = make_state(8, 60, 3, spread=6.0)
    single = double.to(torch.float32)
    world = WorldConfig(flock=config)
    for _ in range(20):
        double = step(double, torch.zeros_like(double.shepherds), world)
        single = step(single, torch.zeros_like(single.shepherds), world)
    assert_near(single.sheep.double(), double.sheep, 1e-2)  # rounding grows as sheep interact


@pytest.mark.parametrize('config', NOISY_FLOCKS[:1], ids=flock_ids[:1])
def test_the_same_seed_gives_the_same_way_and_another_seed_another(config: Any) -> None:
    def run(seed: int) -> WorldState:
        state = replace(make_state(8, 30, 3), seed=torch.tensor(seed))
        for _ in range(10):
            state = step(state, torch.zeros_like(state.shepherds), WorldConfig(flock=config))
        return state

    assert_same_world(run(1), run(1))
    assert (run(1).sheep - run(2).sheep).abs().max() > 0.1


# --- the table of models ------------------------------------------------------------------------


def test_flock_models_are_found_by_name_and_by_configuration() -> None:
    assert set(FLOCK_MODELS) >= {'strombom', 'reynolds'}
    for name, model in FLOCK_MODELS.items():
        assert FLOCK_MODELS[name] is model and model.name == name
        assert model_of(model.config()) is model


def test_an_unknown_flock_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(ConfigError, match=r"'strombum'.*did you mean 'strombom'\?"):
        FLOCK_MODELS['strombum']


def test_first_headings_are_unit_vectors_in_all_directions() -> None:
    heading = FLOCK_MODELS['strombom'].first_heading(torch.arange(50), 100, StrombomFlock())
    assert heading.shape == (50, 100, 2)
    assert_near(heading.norm(dim=-1), torch.ones(50, 100), 1e-6)
    assert heading.mean(dim=(0, 1)).norm() < 0.05


def test_a_reynolds_flock_starts_with_one_heading_and_a_spread_around_it() -> None:
    seed = torch.arange(200)
    first_heading = FLOCK_MODELS['reynolds'].first_heading
    common = first_heading(seed, 100, ReynoldsFlock(heading_spread=0.0))
    assert_near(common, common[:, :1].expand_as(common), 1e-6)
    assert common[:, 0].mean(dim=0).norm() < 0.2  # common headings of flocks are spread evenly
    spread = first_heading(seed, 100, ReynoldsFlock())
    across = common[..., 0] * spread[..., 1] - common[..., 1] * spread[..., 0]
    along = (common * spread).sum(dim=-1)
    assert 0.29 < torch.atan2(across, along).std() < 0.31


def test_a_common_heading_has_its_own_draw_and_each_sheep_the_next() -> None:
    seed, zero = torch.arange(5), torch.zeros(5, dtype=torch.int64)
    draws = normal(seed, zero, Stream.HEADING, torch.arange(1, 4))
    common = 2 * math.pi * uniform(seed, zero, Stream.HEADING, torch.arange(1))
    heading = FLOCK_MODELS['reynolds'].first_heading(seed, 3, ReynoldsFlock(heading_spread=0.3))
    assert_near(heading, from_bearing(common + 0.3 * draws), 1e-6)
