"""The drover: where it stands, how it gets there, and that it lets go."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise, product
import math
from typing import Any

import pytest
from reference import assert_near, drover_controller, make_state, padded, state_of, World
from shepherd_ros.config import ConfigError
from shepherd_ros.controllers import make_controller
from shepherd_ros.controllers.controller import Memory
from shepherd_ros.controllers.drover import DroverConfig
from shepherd_ros.controllers.formation import middle_of_ring, midway
from shepherd_ros.sim.flocking.reynolds_flock import ReynoldsFlock
from shepherd_ros.sim.flocking.strombom_flock import StrombomFlock
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.transition import step
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor

WORLD = WorldConfig(n_sheep=4, n_shepherds=1)
NOTICE = 65 / 3  # the Strömbom flock's r_s [m]


def square(x: float, y: float, half: float = 1.0) -> list[tuple[float, float]]:
    """Return four sheep around a point, sqrt(2) half from it: as far as in a disc of 2 half."""
    return [(x - half, y - half), (x - half, y + half), (x + half, y - half), (x + half, y + half)]


def scene(sheep: list[tuple[float, float]], shepherds: list[tuple[float, float]]) -> WorldState:
    """Return a state with the goal (4 m) at the origin."""
    return state_of(sheep, shepherds, goal_radius=4.0)


def beside(*states: WorldState) -> WorldState:
    """Return a batch of worlds."""
    names = [field.name for field in fields(WorldState)]
    return WorldState(**{k: torch.stack([getattr(s, k) for s in states]) for k in names})


def settle(
    state: WorldState, steps: int, world: WorldConfig = WORLD, **options: Any
) -> tuple[Tensor, list[Tensor]]:
    """Let shepherds move among still sheep; return the last places, (2,) of one, and all."""
    controller = make_controller('drover', world, **options)
    memory: Memory = controller.begin(state)
    track = [state.shepherds]
    for _ in range(steps):
        command, memory = controller.act(state, memory)
        assert float(command.norm(dim=-1).max()) <= 1.0 + 1e-5
        state = replace(state, shepherds=state.shepherds + command * world.dt)
        track.append(state.shepherds)
    return state.shepherds.squeeze(0), track


def expected(state: WorldState, world: WorldConfig, **options: Any) -> Any:
    """Return the commands (M, 2) of the slow reference."""
    flock = world.flock
    return drover_controller(
        World.of(state), DroverConfig(**options), restless=flock.restless,
        notice=flock.notice_range, top=world.shepherd_speed,
    )  # fmt: skip


OPTIONS: list[dict[str, Any]] = [
    {}, {'standoff': 7.0, 'spacing': 0.4}, {'notice_range': 9.0, 'separation': 6.0, 'gain': 0.2},
    {'ring_reach': -0.5, 'ring_speed': 0.6, 'separation': 0.0}, {'open_from': 6.0},
    {'lone_share': 0.2, 'lone_reach': -0.2, 'lone_speed': 0.9},
    {'close_share': 0.3, 'reopen_share': 0.9},
    {'touch_depth': 2.0, 'touch_angle': 0.5, 'touch_distance': 3.0, 'touch_spacing': 0.6},
]  # fmt: skip


@pytest.mark.parametrize('options', OPTIONS, ids=str)
@pytest.mark.parametrize('flock', [StrombomFlock(), ReynoldsFlock()], ids=['rests', 'restless'])
def test_commands_are_those_of_the_reference(flock: Any, options: dict[str, Any]) -> None:
    world = WorldConfig(flock=flock, shepherd_speed=1.5)
    controller = make_controller('drover', world, **options)
    for m, (seed, near) in product([1, 2, 5], enumerate((0.02, 0.1, 0.3, 1.0))):
        reach = (6, 25)[(m + seed) % 2]
        state = make_state(10 * seed + m, 12, m, spread=1.5 + seed, reach=reach)
        # the flock at the goal, on its rim, near it, anywhere
        shift = (1 - near) * (state.goal - state.center)
        state = replace(state, sheep=state.sheep + shift, shepherds=state.shepherds + shift)
        state = padded(state, sheep=2, shepherds=1)
        command, _ = controller.act(state, controller.begin(state))
        assert_near(command[:m], expected(state, world, **options), 1e-5)


def test_one_shepherd_stands_behind_the_flock_as_far_as_it_is_noticed() -> None:
    # center 10 m from the goal, edge 2 m from it, 4.5 m more: 16.5 m < r_s
    place, _ = settle(scene(square(10, 0), [(14.0, 3.0)]), 200)
    assert place.tolist() == pytest.approx([NOTICE, 0.0], abs=0.05)


def test_far_away_it_keeps_the_stand_off() -> None:
    # 30 + 2 + 6 m from the goal is more than r_s
    place, _ = settle(scene(square(0, 30), [(3.0, 40.0)]), 200, standoff=6.0)
    assert place.tolist() == pytest.approx([0.0, 38.0], abs=0.05)


def test_it_goes_round_the_flock_and_not_through_it() -> None:
    sheep = square(10, 0)
    place, track = settle(scene(sheep, [(0.0, 0.1)]), 300)
    assert place.tolist() == pytest.approx([NOTICE, 0.0], abs=0.05)
    center = torch.tensor([10.0, 0.0])
    nearest = min(float((at - center).norm(dim=-1)) for at in track)
    assert nearest > 2 + 4.5 - 0.6  # a step of half a metre may cut the circle


def test_three_stand_on_an_arc_with_the_chosen_angle() -> None:
    world = replace(WORLD, n_shepherds=3)
    state = scene(square(10, 0), [(20.0, -2.0), (20.0, 0.0), (20.0, 2.0)])
    places, _ = settle(state, 200, world, spacing=0.3)
    assert places.norm(dim=-1).tolist() == pytest.approx([NOTICE] * 3, abs=0.05)
    bearing = torch.atan2(places[:, 1], places[:, 0])
    assert bearing.tolist() == pytest.approx([-0.3, 0.0, 0.3], abs=0.01)


def test_with_the_flock_home_the_team_closes_a_ring_from_where_no_sheep_is_moved() -> None:
    world = replace(WORLD, n_shepherds=3)
    state = scene(square(0, 0), [(20.0, -2.0), (20.0, 0.0), (20.0, 2.0)])
    places, track = settle(state, 700, world)
    edge = NOTICE + 0.45 * 4.0
    assert places.norm(dim=-1).tolist() == pytest.approx([edge] * 3, abs=0.05)
    assert gaps_of(places) == pytest.approx([2 * math.pi / 3] * 3, abs=0.02)
    # once out there nobody cuts through
    out = [float(at.norm(dim=-1).min()) for at in track]
    assert min(out[20:]) > NOTICE


def gaps_of(places: Tensor) -> list[float]:
    """Return the angles between neighbours (H, 2) m around the origin [rad]."""
    bearing = torch.atan2(places[:, 1], places[:, 0]).sort().values
    return torch.cat([bearing.diff(), bearing[:1] + 2 * math.pi - bearing[-1:]]).tolist()


def test_the_arc_opens_as_the_flock_comes_home() -> None:
    # an arc from 1.5 goal radii (6 m) on, a ring within a tenth: half of each at 3.2 m
    arcs = {6.0: 1.0, 3.2: 0.5, 1.8: 0.25, 0.4: 0.0, 0.1: 0.0}  # by how far the flock is [m]
    world = replace(WORLD, n_shepherds=3)
    team = [(20.0, -2.0), (20.0, 0.0), (20.0, 2.0)]
    worlds, _ = settle(beside(*(scene(square(away, 0), team) for away in arcs)), 700, world)
    for places, arc in zip(worlds, arcs.values(), strict=True):
        distance = arc * NOTICE + (1 - arc) * (NOTICE + 0.45 * 4)
        assert places.norm(dim=-1).tolist() == pytest.approx([distance] * 3, abs=0.05)
        spacing = arc * 0.25 + (1 - arc) * 2 * math.pi / 3
        rest = 2 * math.pi - 2 * spacing
        assert sorted(gaps_of(places)) == pytest.approx(sorted([spacing, spacing, rest]), abs=0.02)


def test_it_remembers_nothing() -> None:
    world = WorldConfig(n_sheep=20, n_shepherds=3)
    controller = make_controller('drover', world)
    state = spawn(world, torch.arange(4))
    memory = controller.begin(state)
    for _ in range(200):  # the flock comes home on the way
        command, memory = controller.act(state, memory)
        assert torch.equal(command, controller.act(state, controller.begin(state))[0])
        state = step(state, command, world)
    assert float((state.gap <= 0).float().mean()) > 0.9


def test_a_lone_shepherd_circles_when_enough_are_inside() -> None:
    flocks = [[(0.0, 0.0)] * inside + [(0.0, 6.0)] * (5 - inside) for inside in (3, 4)]
    world = WorldConfig(n_sheep=5, n_shepherds=1)
    start = beside(*(scene(sheep, [(24.0, 0.0)]) for sheep in flocks))
    behind, circling = settle(start, 700, world, lone_share=0.8)[1][-1].squeeze(-2).tolist()
    # 0.6 inside: behind the flock's center; 0.8: where sheep 0.6 goal radii from it notice
    assert behind == pytest.approx([0.0, NOTICE], abs=0.1)
    assert math.hypot(*circling) == pytest.approx(NOTICE + 0.6 * 4, abs=0.05)


def test_its_circle_is_counter_clockwise_at_the_pace_of_its_option() -> None:
    circle = NOTICE + 0.6 * 4
    for speed in (0.4, 0.8):
        _, track = settle(scene(square(0, 0), [(circle, 0.0)]), 40, lone_speed=speed)
        angle = [math.atan2(*reversed(at[0].tolist())) for at in track]
        # 0.5 s a step: 0.2 and 0.4 m along a circle of 24 m
        turns = [after - before for before, after in pairwise(angle)]
        assert turns == pytest.approx([0.5 * speed / circle] * 40, rel=0.01)


def test_an_arc_that_opens_after_it_is_a_ring_is_refused() -> None:
    with pytest.raises(ConfigError, match=r'open_until is 1\.5: expected less than open_from'):
        make_controller('drover', WORLD, open_until=1.5)


def test_how_near_sheep_notice_is_that_of_the_flock_or_what_is_given() -> None:
    world = replace(WORLD, n_shepherds=3, flock=ReynoldsFlock())
    team = [(9.0, -2.0), (9.0, 0.0), (9.0, 2.0)]
    places, _ = settle(scene(square(1, 0), team), 100, world)
    # all four are inside: a ring so narrow that none can be there unnoticed
    assert places.norm(dim=-1).tolist() == pytest.approx([7.5 - 0.15 * 4] * 3, abs=0.1)
    place, _ = settle(scene(square(10, 0), [(30.0, 0.0)]), 100, notice_range=25.0)
    assert place.tolist() == pytest.approx([25.0, 0.0], abs=0.05)


def test_one_shepherd_touches_the_rim_of_a_flock_that_never_rests() -> None:
    world = replace(WORLD, flock=ReynoldsFlock())
    place, _ = settle(scene(square(4, 0), [(15.0, 1.0)]), 200, world)
    # behind the flock: 2 m to its edge, and 0.4 m less than it sees
    reach = 2 + 7.5 - 0.4
    assert place.tolist() == pytest.approx([4 + reach, 0.0], abs=0.05)
    # in the middle of the goal the flock heads for +x and is turned by a radian
    place, _ = settle(scene(square(0, 0.003), [(15.0, 1.0)]), 200, world)
    assert place.norm().item() == pytest.approx(reach, abs=0.05)
    behind = math.pi / 2  # of the goal is where it is: the sense of its turn is kept
    angle = math.atan2(place[1].item(), place[0].item())
    assert angle == pytest.approx(behind + 1.0, abs=0.01)


def test_a_sheep_that_is_astray_does_not_draw_the_team_from_the_flock() -> None:
    # 99 in a heap and one 20 m from it: the edge of a disc with that mean square is 2.8 m off
    sheep = [(30.0, 0.0)] * 99 + [(30.0, 20.0)]
    place, _ = settle(scene(sheep, [(40.0, 1.0)]), 200, replace(WORLD, n_sheep=100))
    edge = math.sqrt(2 * (20 * 20 * 0.01 - 0.2**2))
    middle = math.hypot(30, 0.2)
    assert place.norm().item() == pytest.approx(middle + edge + 4.5, abs=0.05)


def command(shepherds: list[tuple[float, float]], **options: Any) -> Tensor:
    """Return what shepherds do at first, far from a flock that is farther than r_s, (H, 2)."""
    world = replace(WORLD, n_shepherds=len(shepherds))
    controller = make_controller('drover', world, **options)
    state = scene(square(0, 60), shepherds)
    return controller.act(state, controller.begin(state))[0].reshape(-1, 2)


def test_shepherds_make_way_for_each_other() -> None:
    # 0.6 m apart, 1.5 m being asked for: 2 (1 - 0.6 / 1.5) m/s, half right of straight apart
    alone = command([(0.0, 100.0), (0.6, 100.0)], separation=0.0)
    aside = 1.2 * math.sqrt(0.5)
    wanted = alone + torch.tensor([[-aside, -aside], [aside, aside]])
    wanted = wanted / wanted.norm(dim=-1, keepdim=True).clamp(min=1.0)
    torch.testing.assert_close(command([(0.0, 100.0), (0.6, 100.0)]), wanted)
    # as near as they want to be, they do as if alone
    torch.testing.assert_close(
        command([(0.0, 100.0), (1.5, 100.0)]),
        command([(0.0, 100.0), (1.5, 100.0)], separation=0.0),
    )


def test_two_who_are_in_each_others_way_pass() -> None:
    world = replace(WORLD, n_shepherds=2)
    # both are behind the flock and have each other's place on the way
    state = scene(square(0, 60), [(-6.0, 20.0), (6.0, 20.0)])
    places, track = settle(state, 400, world)
    assert float(torch.stack([(at[0, 0] - at[0, 1]).norm() for at in track]).min()) > 0.75
    ahead = 62 + 4.5
    assert places.norm(dim=-1).tolist() == pytest.approx([ahead] * 2, abs=0.1)


@pytest.mark.parametrize('turn', [0.0, 1.0, -2.5])
def test_the_ring_of_three_and_more_is_where_they_are(turn: float) -> None:
    third = 2 * math.pi / 3
    mask = torch.tensor([True, True, True, False])

    def places(*angle: float) -> list[float]:
        wrapped = torch.tensor([[*angle, 9.0]]) + turn
        middle = middle_of_ring(torch.remainder(wrapped, 2 * math.pi), mask[None])[0].item()
        return sorted((middle - turn + k * third) % (2 * math.pi) for k in (-1, 0, 1))

    # beside each other: around their mean, which is 0.1; all around: the mean of what each is off
    for angles, middle in [((0.3, -0.2, 0.2), 0.1), ((0.1, third + 0.3, -third - 0.1), 0.1)]:
        expected = sorted((middle + k * third) % (2 * math.pi) for k in (-1, 0, 1))
        assert places(*angles) == pytest.approx(expected, abs=1e-5)


def test_each_of_a_ring_goes_midway_between_its_neighbours() -> None:
    mask = torch.arange(5) < torch.tensor([[4], [2], [1]])
    angle = torch.tensor([[0.1, 3.0, -0.3, 1.0, 0.2]] * 3)
    # around the circle -0.3, 0.1, 1, 3; two stand across from each other; one alone stays
    expected = [
        [0.35, (1.0 - 0.3 + 2 * math.pi) / 2, (3.0 - 2 * math.pi + 0.1) / 2, 1.55],
        [3.0 - math.pi, 0.1 + math.pi],
        [0.1],
    ]
    for row, places in enumerate(expected):
        result = midway(angle, mask)[row, : len(places)]
        assert torch.sin(result).tolist() == pytest.approx([math.sin(x) for x in places], abs=1e-5)
        assert torch.cos(result).tolist() == pytest.approx([math.cos(x) for x in places], abs=1e-5)


@pytest.mark.parametrize('shepherds', [1, 2])
def test_sheep_that_never_rest_are_kept_near_the_goal_by_one_or_two(shepherds: int) -> None:
    world = WorldConfig(n_sheep=50, n_shepherds=shepherds, flock=ReynoldsFlock())
    controller = make_controller('drover', world)
    state = spawn(world, torch.arange(8))
    memory = controller.begin(state)
    inside = []
    for k in range(700):
        command, memory = controller.act(state, memory)
        state = step(state, command, world)
        if k >= 400:
            inside.append((state.gap <= 0).float().mean())
    # a ring of one or two keeps 0.1 to 0.3
    assert float(torch.stack(inside).mean()) > 0.55


def test_sheep_that_never_rest_are_kept_home_by_a_ring_of_three_and_more() -> None:
    world = WorldConfig(n_sheep=50, n_shepherds=6, flock=ReynoldsFlock())
    world = replace(world, spawn=replace(world.spawn, fewest_shepherds=3))
    controller = make_controller('drover', world)
    state = spawn(world, torch.arange(16))
    assert int(state.team_size.min()) >= 3
    memory = controller.begin(state)
    for _ in range(600):
        command, memory = controller.act(state, memory)
        state = step(state, command, world)
    inside = (state.gap <= 0).float().mean(dim=-1)
    assert float((inside > 0.95).float().mean()) >= 0.8


def test_a_flock_is_brought_home_and_comes_to_rest() -> None:
    world = WorldConfig(n_sheep=50, n_shepherds=3)
    controller = make_controller('drover', world)
    state = spawn(world, torch.arange(8))
    memory = controller.begin(state)
    moved = torch.zeros(())
    for k in range(500):
        command, memory = controller.act(state, memory)
        after = step(state, command, world)
        if k >= 400:
            moved = moved + (after.sheep - state.sheep).norm(dim=-1).mean() / 100
        state = after
    assert float((state.gap <= 0).float().mean()) > 0.98
    # grazing sheep take a random step now and then, driven ones make 1/6 m each time
    assert float(moved) < 1 / 6 / 4
