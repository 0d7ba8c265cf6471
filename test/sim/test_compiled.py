"""The compiled forms equal the plain ones, on the same float32 worlds."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from shepherd_ros.controllers import make_controller
from shepherd_ros.sim import compiled
from shepherd_ros.sim.flocking import model_of
from shepherd_ros.sim.flocking.reynolds_flock import ReynoldsFlock
from shepherd_ros.sim.flocking.strombom_flock import StrombomFlock
from shepherd_ros.sim.lidar import LidarConfig, scan
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.transition import move, step
from shepherd_ros.sim.world import SpawnConfig, WorldConfig
import torch

FLOCKS = [
    StrombomFlock(),
    StrombomFlock(n_neighbors=5),
    StrombomFlock(n_neighbors=25),
    StrombomFlock(normalize_shepherds=True, sheep_range=3.0),
    StrombomFlock(metric_attraction=True, sheep_range=10.0),
    StrombomFlock(shepherd_range=6.0, graze_probability=0.5),
    ReynoldsFlock(),
    ReynoldsFlock(view_range=2.5, max_acceleration=5.0),
    ReynoldsFlock(terms='raw'),
]
CONTROLLERS = [
    ('strombom', {}),
    ('strombom', {'position_law': 'elfiqi', 'wing_spacing': 0.4, 'noise': 0.0}),
    ('strombom', {'stop_range': 0.0, 'arc_margin': 8.0, 'interaction_range': 2.0}),
    ('strombom', {'stop_distance': 6.0, 'arc': 'rms', 'arc_margin': 7.0}),
    ('pierson', {}),
    ('pierson', {'pace': 'constant'}),
    ('pierson', {'assignment': 'fixed', 'max_radius': 6.0, 'tracking_gain': 0.5}),
]
SMALL = [
    ('strombom', {'interaction_range': 0.5}),
    ('strombom', {'position_law': 'elfiqi', 'interaction_range': 1.5, 'standoff': 3.0}),
    ('pierson', {'lead': 3.0, 'gain': 0.3, 'max_turn_rate': 0.2}),
]  # whose terms would be equal by chance in a metre or a turn of one


def worlds(flock, n_sheep: int, batch: int) -> tuple[WorldConfig, WorldState]:
    start = SpawnConfig(position_std=4.0, fewest_shepherds=1)
    config = WorldConfig(n_sheep=n_sheep, n_shepherds=5, flock=flock, spawn=start)
    state = spawn(config, torch.arange(batch) + 40)
    fewer = torch.arange(n_sheep) < (n_sheep - torch.arange(batch)).clamp(min=1)[:, None]
    return config, replace(state, sheep_mask=fewer)


def both(monkeypatch: pytest.MonkeyPatch, law, *arguments):
    assert compiled.HAS_NUMBA, 'numba is part of what make installs'
    fast = law(*arguments)
    monkeypatch.setattr(compiled, 'HAS_NUMBA', False)
    plain = law(*arguments)
    monkeypatch.undo()
    return fast, plain


def test_a_compiled_flock_step_equals_the_plain_one(monkeypatch) -> None:
    for n_sheep, flock in product([1, 2, 30, 100], FLOCKS):
        config, state = worlds(flock, n_sheep, batch=6)
        law = model_of(flock).step
        for _ in range(3):
            fast, plain = both(monkeypatch, law, state, flock, config.dt)
            present = state.sheep_mask
            torch.testing.assert_close(fast[0][present], plain[0][present], atol=2e-5, rtol=0)
            torch.testing.assert_close(fast[1][present], plain[1][present], atol=1e-4, rtol=0)
            state = step(state, torch.ones_like(state.shepherds), config)


@pytest.mark.parametrize(('n_rays', 'contact'), product([4, 90, 512], ['all', 'facing']))
def test_a_compiled_scan_equals_the_plain_one_but_for_rays_that_graze_a_rim(
    monkeypatch, n_rays, contact
) -> None:
    _, state = worlds(StrombomFlock(), 60, batch=8)
    state.shepherds[:, 1] = state.shepherds[:, 0] + torch.tensor([0.2, 0.1])
    state.shepherds[:, 2] = state.sheep[:, 0] + torch.tensor([-0.1, 0.3])
    inside, radius = state.shepherds[:, 0] + torch.tensor([1.5, -0.5]), torch.arange(8) + 1.0
    state = replace(state, goal=inside, goal_radius=radius)
    config = LidarConfig(n_rays=n_rays, range_max=20.0, contact=contact)
    fast, plain = both(monkeypatch, scan, state, config)
    same = (fast == plain) | ((fast - plain).abs() < 2e-3)
    assert same.float().mean() > 0.9995
    assert plain.isfinite().any() and (~plain.isfinite()).any()


def test_a_compiled_scan_of_chosen_shepherds_is_those_rows_of_the_whole() -> None:
    _, state = worlds(StrombomFlock(), 60, batch=3)
    whole = scan(state, LidarConfig(range_noise=0.1, dropout=0.2))
    chosen = torch.tensor([3, 1])
    part = scan(state, LidarConfig(range_noise=0.1, dropout=0.2), chosen)
    assert torch.equal(part, whole[:, chosen])


@pytest.mark.parametrize(('name', 'options'), CONTROLLERS)
def test_a_compiled_controller_answers_as_the_plain_one_but_where_places_are_equally_good(
    monkeypatch, name, options
) -> None:
    for n_sheep in (1, 2, 30, 100):
        config, state = worlds(StrombomFlock(), n_sheep, batch=12)
        controller = make_controller(name, config, **options)
        memory, same = controller.begin(state), []
        for _ in range(20):
            (fast, after), (plain, expected) = both(monkeypatch, controller.act, state, memory)
            torch.testing.assert_close(after, expected, atol=1e-5, rtol=0)
            same.append((fast - plain).abs().amax(dim=(-2, -1)) < 5e-4)
            state, memory = step(state, plain, config), expected
        assert torch.stack(same).float().mean() > 0.99  # of 240; a draw falls by the last digit


@pytest.mark.parametrize(('name', 'options'), [*CONTROLLERS, *SMALL])
def test_a_compiled_controller_answers_as_the_plain_one_wherever_goal_and_heading_are(
    monkeypatch, name, options
) -> None:
    for n_sheep in (1, 3, 12):
        config, state = worlds(StrombomFlock(), n_sheep, batch=24)
        config, turn = replace(config, dt=0.3), torch.arange(24.0)
        state.sheep_mask[:, :3] = True  # as two are equally far from their center
        state.shepherds[::4, 1] = state.shepherds[::4, 0]  # who are told apart by their index
        goal = state.goal + torch.stack([7.0 - turn, turn - 3.0], dim=-1)
        state = replace(state, goal=goal)
        controller = make_controller(name, config, **options)
        memory = {key: torch.sin(turn) * torch.pi for key in controller.begin(state)}
        monkeypatch.setattr(np, 'empty_like', lambda like: np.full_like(like, np.nan))
        fast, plain = both(monkeypatch, controller.act, state, memory)
        torch.testing.assert_close(fast, plain, atol=5e-4, rtol=0)


@pytest.mark.parametrize('name', ['strombom', 'pierson'])
def test_a_compiled_controller_answers_a_world_of_a_batch_as_it_does_that_world_alone(
    name: str,
) -> None:
    config, state = worlds(StrombomFlock(), 30, batch=5)
    controller = make_controller(name, config)
    whole, _ = controller.act(state, controller.begin(state))
    for k in range(5):
        alone = state.world(k)
        assert torch.equal(controller.act(alone, controller.begin(alone))[0], whole[k])


@pytest.mark.parametrize('shape', ['disc', 'two groups', 'a stray', 'a line', 'one point'])
def test_on_a_grid_a_large_flock_moves_as_without(monkeypatch, shape) -> None:
    near = StrombomFlock(n_neighbors=30, sheep_range=2.5)
    for flock, n_sheep in product([near, StrombomFlock(), ReynoldsFlock()], [140, 1600]):
        config, state = worlds(flock, n_sheep, batch=2)
        sheep = state.sheep * (n_sheep / 100) ** 0.5
        if shape == 'two groups':
            sheep[:, ::2] += 60.0
        elif shape == 'a stray':
            sheep[:, 3] -= 5000.0
        elif shape == 'a line':
            sheep[..., 1] = 1.0
        elif shape == 'one point':
            sheep[:] = sheep[:, :1].clone()
        state = replace(state, sheep=sheep, shepherds=state.shepherds + 3.0)
        law = model_of(flock).step
        fast, plain = both(monkeypatch, law, state, flock, config.dt)
        present = state.sheep_mask  # what becomes of the absent is nobody's business
        for own, wanted in zip(fast, plain, strict=True):
            torch.testing.assert_close(own[present], wanted[present], atol=2e-4, rtol=1e-6)


def test_the_farthest_sheep_are_found_however_wide_the_flock_is(monkeypatch) -> None:
    for scale in [0.0, 0.01, 1.0, 1000.0]:
        flock = StrombomFlock(n_neighbors=60, shepherd_range=1e6, metric_attraction=True)
        config, state = worlds(flock, 100, batch=3)
        state = replace(
            state, sheep=state.sheep[:, :1] + scale * (state.sheep - state.sheep[:, :1])
        )
        law = model_of(flock).step
        fast, plain = both(monkeypatch, law, state, flock, config.dt)
        for own, wanted in zip(fast, plain, strict=True):
            torch.testing.assert_close(
                own[state.sheep_mask], wanted[state.sheep_mask], atol=1e-4, rtol=1e-6
            )


def test_compiled_shepherds_move_as_the_plain_ones_do(monkeypatch) -> None:
    for odd in [torch.nan, torch.inf, 1e30, 3e38, 1e-30, 0.0]:
        config, state = worlds(StrombomFlock(), 2, batch=8)
        command = torch.linspace(-3.0, 3.0, state.shepherds.numel()).reshape(state.shepherds.shape)
        command[::2, 0, 1] = odd
        fast, plain = both(monkeypatch, move, state, command, config)
        torch.testing.assert_close(fast, plain, atol=1e-6, rtol=1e-6)
        assert fast.isfinite().all()
