"""The Strömbom controller: roles, places, detours, and the slow reference."""

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
    assert_near,
    batch,
    make_state,
    moved,
    padded,
    state_of,
    strombom_controller,
    turned,
    World,
)
from shepherd_ros.controllers import make_controller
from shepherd_ros.controllers.strombom import StrombomConfig
from shepherd_ros.sim.flocking.reynolds_flock import ReynoldsFlock
from shepherd_ros.sim.flocking.strombom_flock import StrombomFlock
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor

DOUBLE = torch.float64
invariant = settings(max_examples=60, deadline=None, derandomize=True)
seeds = st.integers(0, 2**31)


def act(state: WorldState, world: WorldConfig | None = None, **options: Any) -> Tensor:
    controller = make_controller('strombom', world or WorldConfig(), **options)
    command, memory = controller.act(state, controller.begin(state))
    assert command.shape == state.shepherds.shape
    assert command.dtype == state.shepherds.dtype
    assert memory == {}
    return command


def expected(state: WorldState, world: WorldConfig | None = None, **options: Any) -> np.ndarray:
    world = world or WorldConfig()
    config = StrombomConfig(**options)
    r = config.interaction_range or getattr(world.flock, 'sheep_range', 1.0)
    top, dt = world.shepherd_speed, world.dt
    return strombom_controller(World.of(state), config, r=r, top=top, dt=dt)[0]


def ring_state(seed: int, n: int, m: int) -> WorldState:
    """
    Return a world at a random scale, so that all roles and detours come up.

    In every second one the shepherds are near the arc of detours. Two sheep are equally far from
    their center and a rounding says which comes first: they get no chance to be outliers.
    """
    rng = np.random.default_rng(seed)
    spread, reach = rng.choice([0.5, 2.0, 8.0, 30.0]), rng.choice([5.0, 15.0, 40.0])
    state = make_state(seed, n, m, spread=0.2 if n == 2 else float(spread), reach=float(reach))
    if seed % 2:
        return state
    offset = state.shepherds - state.center
    far = (state.sheep - state.center).norm(dim=-1).max()
    radius = far + torch.tensor(rng.uniform(2.4, 3.4, (m, 1)))
    near_arc = state.center + offset / offset.norm(dim=-1, keepdim=True) * radius
    return replace(state, shepherds=near_arc.float().double())


# --- against the reference ----------------------------------------------------------------------


def test_commands_are_those_of_the_reference() -> None:
    for n, m in product([1, 2, 10, 100], [1, 2, 3, 6, 20]):
        for seed in range(3):
            state = ring_state(100 * n + 10 * m + seed, n, m)
            reference = expected(state)
            assert_near(act(state), reference, 1e-7)
            assert_near(act(state.to(torch.float32)), reference, 1e-4)


def test_commands_for_a_thousand_sheep_are_those_of_the_reference() -> None:
    for spread in (5.0, 60.0):
        state = make_state(1, 1000, 8, spread=spread, reach=50.0)
        assert_near(act(state), expected(state), 1e-7)
        assert_near(act(state.to(torch.float32)), expected(state), 1e-4)


@pytest.mark.parametrize(
    'options',
    [
        {'noise': 0.0},
        {'noise': 2.0},
        {'position_law': 'elfiqi'},
        {'position_law': 'elfiqi', 'standoff': 1.5, 'noise': 0.0},
        {'arc_margin': 8.0},
        {'arc_margin': 21.7, 'noise': 0.0},
        {'arc': 'rms'},
        {'arc': 'rms', 'arc_margin': 2.0, 'noise': 0.0},
        {'arc_tolerance': 1.0},
        {'arc_tolerance': 4.0},
        {'wing_spacing': 0.6},
        {'interaction_range': 2.5},
        {'stop_range': 0.0},
        {'stop_range': 8.0},
        {'stop_distance': 8.0},
        {'stop_distance': 2.0, 'stop_range': 0.0, 'position_law': 'elfiqi'},
    ],
    ids=str,
)
def test_every_option_is_that_of_the_reference(options: dict[str, Any]) -> None:
    for dt, seed in product([0.1, 1.0], range(10)):
        world = WorldConfig(dt=dt, shepherd_speed=1.5)
        state = ring_state(seed, 20, 4)
        reference = expected(state, world, **options)
        assert_near(act(state, world, **options), reference, 1e-7)


def test_the_range_is_that_of_the_flock_or_one_meter_or_that_given() -> None:
    for flock, r in ((StrombomFlock(sheep_range=2.0), 2.0), (ReynoldsFlock(), 1.0)):
        world = WorldConfig(flock=flock)
        assert make_controller('strombom', world).interaction_range == r
        given_range = make_controller('strombom', world, interaction_range=0.7)
        assert given_range.interaction_range == 0.7
        state = ring_state(3, 15, 3)
        assert_near(act(state, world), expected(state, world), 1e-7)


def test_the_comparison_meets_every_role_and_every_kind_of_way() -> None:
    met = dict.fromkeys(('collect', 'drive', 'stop', 'spiral', 'arc', 'straight'), 0)
    for seed in range(60):
        state = ring_state(seed, 20, 4)
        center, stop = state.center, torch.cdist(state.shepherds, state.sheep).amin(-1) < 3
        far = (state.sheep - center).norm(dim=-1)
        met['collect'] += int((far > 20 ** (2 / 3)).any())
        met['drive'] += int((far > 20 ** (2 / 3)).sum() < 4)
        straight = expected(state, noise=0.0, arc_tolerance=4.0, stop_range=0.0)
        direction = expected(state, noise=0.0, stop_range=0.0)
        about = np.abs(direction - straight).max(axis=-1) > 1e-9
        inside = ((state.shepherds - center).norm(dim=-1) < far.max() + 3 - 0.5).numpy()
        met['stop'] += int(stop.sum())
        met['spiral'] += int((about & inside).sum())
        met['arc'] += int((about & ~inside).sum())
        met['straight'] += int((~about).sum())
    assert min(met.values()) >= 5, met


# --- roles and places by hand -------------------------------------------------------------------


def plus_of_sheep(far: float) -> list[list[float]]:
    """Return 28 sheep 1 m around (0, 0), and 4 so far on the axes."""
    ring = [2 * math.pi * k / 28 for k in range(28)]
    near = [[math.cos(a), math.sin(a)] for a in ring]
    return [*near, [far, 0.0], [0.0, far], [-far, 0.0], [0.0, -far]]


def target_of(state: WorldState, **options: Any) -> Tensor:
    """Return where the shepherds go when nothing is in their way: read from unlimited commands."""
    world = WorldConfig(shepherd_speed=1e6, dt=1.0)
    quiet = {'noise': 0.0, 'stop_range': 0.0, 'arc_tolerance': 4.0, **options}
    return state.shepherds + act(state, world, **quiet)


def test_together_means_within_r_times_n_to_the_two_thirds() -> None:
    # 32 sheep: 32^(2/3) = 10.08; all four far ones are on it or beyond
    shepherds = [[40.0, 1.0]]
    inside = target_of(state_of(plus_of_sheep(10.0), shepherds, goal=[-50.0, 0.0]))
    assert_near(inside, [[32**0.5, 0.0]], 1e-6)  # driving, sqrt(32) behind
    outside = target_of(state_of(plus_of_sheep(10.1), shepherds, goal=[-50.0, 0.0]))
    assert_near(outside.abs().amax(), 11.1, 1e-6)  # collecting one of the four
    assert_near(outside.abs().amin(), 0.0, 1e-6)


def test_the_nearest_shepherd_gets_the_farthest_sheep_first_and_the_others_drive() -> None:
    # 62 sheep at the center and two outliers that balance: center (0, 0), 64^(2/3) = 16
    sheep = [[0.0, 0.0]] * 61 + [[30.0, 0.0], [-20.0, 0.0], [-10.0, 0.0]]
    shepherds = [[5.0, 1.0], [20.0, 0.0], [-5.0, -2.0]]
    state = state_of(sheep, shepherds, goal=[0.0, -50.0])
    # farthest first: (30, 0) takes shepherd 1, (-20, 0) takes shepherd 2, shepherd 0 drives
    assert_near(target_of(state), [[0.0, 8.0], [31.0, 0.0], [-21.0, 0.0]], 1e-6)


def test_a_shepherd_taken_by_the_farthest_sheep_is_not_there_for_the_next() -> None:
    sheep = [[0.0, 0.0]] * 61 + [[30.0, 0.0], [20.0, 0.0], [-50.0, 0.0]]
    shepherds = [[60.0, 0.0], [25.0, 0.0], [-60.0, 0.0]]
    state = state_of(sheep, shepherds, goal=[0.0, -50.0])
    # (-50, 0) takes shepherd 2; (30, 0) takes shepherd 1; (20, 0) is left with shepherd 0
    assert_near(target_of(state), [[21.0, 0.0], [31.0, 0.0], [-51.0, 0.0]], 1e-6)


def test_with_more_outliers_than_shepherds_only_the_farthest_are_collected() -> None:
    sheep = [[0.0, 0.0]] * 60 + [[30.0, 0.0], [-30.5, 0.0], [0.0, 25.0], [0.5, -25.0]]
    state = state_of(sheep, [[1.0, 0.0], [-1.0, 0.0]], goal=[0.0, -50.0])
    far = torch.tensor([[30.0, 0.0], [-30.5, 0.0]], dtype=DOUBLE)
    assert_near((target_of(state) - far).norm(dim=-1), [1.0, 1.0], 1e-6)


def test_drivers_stand_on_an_arc_behind_the_flock_in_the_order_of_their_bearings() -> None:
    # goal at -x: behind is +x; three shepherds, 30 degrees apart, sqrt(4) = 2 m from the center
    sheep = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]
    shepherds = [[8.0, 4.0], [9.0, 0.5], [8.0, -5.0]]
    state = state_of(sheep, shepherds, goal=[-50.0, 0.0])
    c, s = 2 * math.cos(math.pi / 6), 2 * math.sin(math.pi / 6)
    assert_near(target_of(state), [[c, s], [2.0, 0.0], [c, -s]], 1e-6)
    swapped = replace(state, shepherds=state.shepherds[[2, 0, 1]])
    assert_near(target_of(swapped), [[c, -s], [c, s], [2.0, 0.0]], 1e-6)
    wide = target_of(state, wing_spacing=math.pi / 2)
    assert_near(wide, [[0.0, 2.0], [2.0, 0.0], [0.0, -2.0]], 1e-6)


def test_position_law_elfiqi_by_hand() -> None:
    # 8 sheep: together within sqrt(16) = 4 m, drive 4 + 4 behind
    sheep = [[3.0 * math.cos(a), 3.0 * math.sin(a)] for a in np.arange(8) * math.pi / 4]
    state = state_of(sheep, [[20.0, 1.0]], goal=[-50.0, 0.0])
    assert_near(target_of(state, position_law='elfiqi'), [[8.0, 0.0]], 1e-6)
    # scaled: 4.5 m is too far, collect from 4 m behind one of them
    apart = replace(state, sheep=state.sheep * 1.5)
    reached = target_of(apart, position_law='elfiqi')
    assert_near(reached.norm(), 8.5, 1e-6)


# --- speed --------------------------------------------------------------------------------------


@invariant
@given(seeds, st.integers(1, 40), st.integers(1, 20), st.floats(0.0, 3.0), st.floats(0.05, 2.0))
def test_no_command_is_faster_than_the_top_speed(
    seed: int, n: int, m: int, top: float, dt: float
) -> None:
    world = WorldConfig(shepherd_speed=top, dt=dt)
    for dtype in (torch.float64, torch.float32):
        command = act(ring_state(seed, n, m).to(dtype), world)
        assert command.isfinite().all()
        assert (command.norm(dim=-1) <= top * (1 + 1e-6)).all()


def test_a_shepherd_slows_down_to_arrive_and_not_to_overshoot() -> None:
    sheep = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]
    state = state_of(sheep, [[2.2, 0.1]], goal=[-50.0, 0.0])  # its place is (2, 0)
    command = act(state, WorldConfig(dt=0.5), noise=0.0, stop_range=0.0)
    assert_near(command, [[-0.4, -0.2]], 1e-9)
    present = replace(state, shepherds=torch.tensor([[2.0, 0.0]], dtype=DOUBLE))
    assert_near(act(present, noise=0.0, stop_range=0.0), [[0.0, 0.0]], 1e-9)


def test_a_shepherd_stands_still_while_a_sheep_is_near_and_only_then() -> None:
    state = state_of([[0.0, 0.0]], [[2.99, 0.0], [3.01, 0.0], [0.0, 2.0]], goal=[-50.0, 0.0])
    still = act(state).norm(dim=-1) == 0
    assert still.tolist() == [True, False, True]
    assert (act(state, stop_range=0.0).norm(dim=-1) > 0).all()
    assert (act(state, stop_range=4.0).norm(dim=-1) == 0).all()


def test_noise_turns_the_way_and_keeps_the_speed() -> None:
    state = make_state(2, 10, 6, spread=1.0, reach=40.0)
    clean, noisy = act(state, noise=0.0), act(state, noise=0.3)
    assert_near(noisy.norm(dim=-1), clean.norm(dim=-1), 1e-9)
    assert (noisy - clean).norm(dim=-1).max() > 0.05
    later = replace(state, step=state.step + 1)
    assert (act(later, noise=0.3) - noisy).norm(dim=-1).max() > 0.05
    assert torch.equal(act(state, noise=0.3), noisy)


# --- detours ------------------------------------------------------------------------------------


def walk(
    state: WorldState, steps: int, world: WorldConfig, **options: Any
) -> tuple[list[Tensor], list[Tensor]]:
    """Return places and commands of shepherds round a flock that stands still."""
    places, commands = [state.shepherds], []
    for _ in range(steps):
        commands.append(act(state, world, **{'noise': 0.0, 'stop_range': 0.0, **options}))
        state = replace(state, shepherds=state.shepherds + world.dt * commands[-1])
        places.append(state.shepherds)
    return places, commands


def test_a_detour_goes_round_the_flock_at_top_speed_and_straight_to_its_bearing() -> None:
    # 16 sheep in a ring of 4 m about (3, -2): the place is 4 m behind, the arc has 4 + 3 m
    center = torch.tensor([3.0, -2.0], dtype=DOUBLE)
    ring = torch.arange(16, dtype=DOUBLE) * (math.pi / 8)
    sheep = center + 4 * torch.stack([torch.cos(ring), torch.sin(ring)], -1)
    target, arc = center + torch.tensor([4.0, 0.0], dtype=DOUBLE), 7.0
    starts, states = [], []
    for start, bearing in product(
        (0.7, 3.0, 6.5, 9.0, 14.0, 30.0), (0.3, 1.0, 2.0, 2.9, -3.1, -2.0, -0.5)
    ):
        direction = torch.tensor([math.cos(bearing), math.sin(bearing)], dtype=DOUBLE)
        starts.append(start)
        states.append(state_of(sheep, center + start * direction, goal=[-50.0, -2.0]))
    for dt in (0.1, 0.5, 1.0):
        places, commands = walk(batch(states), int(60 / dt), WorldConfig(dt=dt))
        for b, start in enumerate(starts):
            offset = [(p[b, 0] - center).tolist() for p in places]
            left = [-math.atan2(y, x) for x, y in offset]
            distance = [math.hypot(x, y) for x, y in offset]
            speed = [math.hypot(*c[b, 0].tolist()) for c in commands]
            assert max(speed) <= 1 + 1e-9
            for t in range(len(commands)):
                if abs(left[t]) <= 0.2:
                    continue
                if distance[t] <= arc:  # on its way round
                    assert speed[t] == pytest.approx(1.0)
                    assert distance[t + 1] >= distance[t] - 1e-9
                assert distance[t + 1] >= min(start, arc) - 1e-6
                assert abs(left[t + 1]) <= abs(left[t]) + 1e-12
                assert left[t + 1] * left[t] > 0  # it does not turn back
            assert_near(places[-1][b, 0], target, 1e-6)


def test_a_shepherd_on_the_arc_stays_on_it() -> None:
    # the flock has no width: the arc has 3 m, and the place lies 2 m behind
    start = [[3 * math.cos(2.5), 3 * math.sin(2.5)]]
    state = state_of([[0.0, 0.0]] * 4, start, goal=[-50.0, 0.0])
    places, _ = walk(state, 12, WorldConfig(dt=0.5))
    for place in places:
        assert_near(place.norm(), 3.0, 1e-9)


def test_a_shepherd_goes_round_on_the_shorter_side() -> None:
    for side in (1.0, -1.0):
        state = state_of([[0.0, 0.0]], [[-3.0, 0.5 * side]], goal=[-50.0, 0.0])
        assert act(state, noise=0.0, stop_range=0.0)[0, 1] * side > 0


def test_a_shepherd_whose_way_misses_the_flock_goes_straight() -> None:
    sheep = [[0.0, 0.0]]
    state = state_of(sheep, [[-1.0, 30.0]], goal=[-50.0, 0.0])
    direction = torch.tensor([[2.0, -30.0]], dtype=DOUBLE)
    assert_near(act(state, noise=0.0), direction / direction.norm(), 1e-9)


# --- symmetries and batches ---------------------------------------------------------------------


@invariant
@given(
    seeds,
    st.floats(-math.pi, math.pi),
    st.tuples(st.floats(-100, 100), st.floats(-100, 100)),
    st.integers(1, 40),
    st.integers(1, 8),
)
def test_commands_turn_with_the_world_and_do_not_depend_on_where_it_is(
    seed: int, angle: float, shift: tuple[float, float], n: int, m: int
) -> None:
    state = ring_state(seed, n, m)
    result = act(moved(state, angle, shift), noise=0.0)
    assert_near(result, turned(act(state, noise=0.0), math.cos(angle), math.sin(angle)), 1e-7)


def test_a_batch_equals_each_world_alone_bit_for_bit() -> None:
    for dtype in (torch.float32, torch.float64):
        states = [ring_state(seed, 30, 4).to(dtype) for seed in range(8)]
        together = act(batch(states))
        for index, state in enumerate(states):
            assert torch.equal(together[index], act(state))


def test_mixed_flock_and_team_sizes_in_one_batch_equal_each_alone() -> None:
    # sums over more places may round differently, so the bound is not zero
    sizes = [(1, 1), (2, 6), (30, 20), (100, 3), (17, 2), (30, 1)]
    states = [ring_state(seed, n, m) for seed, (n, m) in enumerate(sizes)]
    together = act(batch(states))
    assert together.isfinite().all()
    for index, state in enumerate(states):
        assert_near(together[index, : len(state.shepherds)], act(state), 1e-9)


@invariant
@given(seeds, st.integers(1, 30), st.integers(1, 6), st.integers(0, 5), st.integers(0, 5))
def test_absent_sheep_and_shepherds_influence_nothing(
    seed: int, n: int, m: int, more_sheep: int, more_shepherds: int
) -> None:
    state = ring_state(seed, n, m)
    state = replace(state, goal=state.center + 0.1)
    command = act(padded(state, more_sheep, more_shepherds))
    assert_near(command[:m], act(state), 1e-9)
    assert command.isfinite().all()


def test_a_shepherd_does_not_stop_for_absent_sheep() -> None:
    state = state_of([[30.0, 0.0]], [[1.0, 0.0]], goal=[0.0, 0.0])  # the absent are 1 m away
    assert_near(act(padded(state, 3), noise=0.0), [[1.0, 0.0]], 1e-12)


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
        'a row': state_of([[float(k), 0.0] for k in range(40)], [[19.5, 0.0], [50.0, 0.0]]),
    }
    for name, state in worlds.items():
        for dtype in (torch.float32, torch.float64):
            for law in ('strombom', 'elfiqi'):
                for stop in (0.0, 3.0):
                    command = act(state.to(dtype), position_law=law, stop_range=stop)
                    assert command.isfinite().all(), name
                    assert (command.norm(dim=-1) <= 1 + 1e-6).all(), name
