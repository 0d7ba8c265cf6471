"""The crowd and drifting obstacles, against slow loops that share nothing with them."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest
from reference import make_state
from shepherd_ros.sim.flocking import FLOCK_MODELS
from shepherd_ros.sim.flocking.crowd import crowd_step, CrowdFlock, targets
from shepherd_ros.sim.flocking.drifting import drifting_step, DriftingFlock
from shepherd_ros.sim.rng import Stream, uniform
from shepherd_ros.sim.state import stack, WorldState
import torch

CROWD = CrowdFlock()


def draw(state: WorldState, step: int, stream: Stream, index: int) -> float:
    return float(uniform(state.seed, torch.tensor(step), stream, torch.tensor(index)))


def target_of(state: WorldState, i: int, dt: float) -> tuple[float, float, float]:
    """Return the target and the preferred speed of pedestrian i."""
    speed = 0.2 + 0.3 * draw(state, 0, Stream.PEDESTRIAN_SPEED, 3 * i)
    phase = draw(state, 0, Stream.PEDESTRIAN_SPEED, 3 * i + 1)
    crossing = math.floor(int(state.step) * dt * speed / 50 + phase)
    edge = (math.floor(4 * draw(state, 0, Stream.PEDESTRIAN_SPEED, 3 * i + 2)) + 2 * crossing) % 4
    along = 50 * (draw(state, crossing * 10_000 + i, Stream.PEDESTRIAN_TARGET, 0) - 0.5)
    return *[(25.0, along), (along, 25.0), (-25.0, along), (along, -25.0)][edge], speed


def push(x: list[float], y: list[float], a: float, b: float) -> tuple[float, float]:
    """Return the push of y on x within 5 m: a exp((0.5 - d) / b) away from it."""
    dx, dy = x[0] - y[0], x[1] - y[1]
    d = math.hypot(dx, dy)
    if not 1e-6 < d < 5:
        return 0.0, 0.0
    size = a * math.exp((0.5 - d) / b)
    return size * dx / d, size * dy / d


def slow_crowd(state: WorldState, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and headings after dt by the equations of Helbing and Molnar, in loops."""
    people, guards = state.sheep.tolist(), state.shepherds.tolist()
    aims = [target_of(state, i, dt) for i in range(len(people))]
    parts = max(1, round(dt / 0.1))
    speeds = []
    for (x, y), (hx, hy), (tx, ty, v) in zip(people, state.heading.tolist(), aims, strict=True):
        far = math.hypot(tx - x, ty - y)
        forward = max(0.0, (hx * (tx - x) + hy * (ty - y)) / far)
        speeds.append([v * forward * hx, v * forward * hy])
    for _ in range(parts):
        after = []
        for i, (place, (u, w), (tx, ty, v)) in enumerate(zip(people, speeds, aims, strict=True)):
            far = math.hypot(tx - place[0], ty - place[1])
            ax, ay = (v * (tx - place[0]) / far - u) / 0.5, (v * (ty - place[1]) / far - w) / 0.5
            others = [push(place, other, 2.1, 0.3) for j, other in enumerate(people) if j != i]
            for px, py in others + [push(place, guard, 4.0, 1.0) for guard in guards]:
                ax, ay = ax + px, ay + py
            u, w = u + ax * dt / parts, w + ay * dt / parts
            scale = min(1.0, 1.3 * v / max(math.hypot(u, w), 1e-9))
            after.append([u * scale, w * scale])
        speeds = after
        people = [
            [x + u * dt / parts, y + w * dt / parts]
            for (x, y), (u, w) in zip(people, speeds, strict=True)
        ]
    norms = [max(math.hypot(u, w), 1e-9) for u, w in speeds]
    return np.array(people), np.array(speeds) / np.array(norms)[:, None]


@pytest.mark.parametrize('dtype', [torch.float32, torch.float64], ids=['compiled', 'plain'])
@pytest.mark.parametrize(('n', 'dt'), [(1, 0.5), (2, 0.05), (7, 0.2), (40, 0.5), (200, 1.0)])
def test_the_crowd_walks_as_the_equations_say(n: int, dt: float, dtype: torch.dtype) -> None:
    state = make_state(n, n, 3, spread=4.0).to(dtype)
    sheep, heading = crowd_step(state, CROWD, dt)
    places, courses = slow_crowd(state, dt)
    assert np.abs(sheep.double().numpy() - places).max() < 1e-4
    assert np.abs(heading.double().numpy() - courses).max() < 1e-3
    moved = torch.linalg.vector_norm(sheep - state.sheep, dim=-1)
    assert (moved <= 1.3 * 0.5 * dt + 1e-5).all()


def test_a_crowd_in_a_batch_walks_as_alone_and_the_absent_push_nobody() -> None:
    states = [make_state(seed, 9, 2) for seed in range(3)]
    together = crowd_step(stack(states), CROWD, 0.5)
    for b, state in enumerate(states):
        for whole, alone in zip(together, crowd_step(state, CROWD, 0.5), strict=True):
            assert torch.equal(whole[b], alone)
    state, few = states[0], torch.arange(9) < 4
    hidden = replace(state, sheep_mask=few, shepherd_mask=torch.tensor([True, False]))
    present = replace(
        state,
        sheep=state.sheep[:4],
        heading=state.heading[:4],
        sheep_mask=few[:4],
        shepherds=state.shepherds[:1],
        shepherd_mask=torch.tensor([True]),
    )
    assert torch.equal(crowd_step(hidden, CROWD, 0.5)[0][:4], crowd_step(present, CROWD, 0.5)[0])


def test_a_pedestrian_alone_crosses_the_square_and_then_turns_to_the_other_side() -> None:
    state = replace(
        make_state(5, 1, 1), step=torch.tensor(0), shepherds=torch.tensor([[500.0, 500.0]])
    )
    target, turned = targets(state, CROWD, 0.5)[0], 0
    for _ in range(700):
        sheep, heading = crowd_step(state, CROWD, 0.5)
        state = replace(state, step=state.step + 1, sheep=sheep, heading=heading)
        following = targets(state, CROWD, 0.5)[0]
        if not torch.equal(following, target):
            edge = following.abs().argmax()
            assert target[edge] == -following[edge]
            target, turned = following, turned + 1
    assert turned >= 2


def test_an_escort_in_the_way_makes_a_pedestrian_give_way_and_the_drifting_do_not_care() -> None:
    state = replace(make_state(5, 1, 1), sheep=torch.zeros(1, 2), step=torch.tensor(0))
    course = targets(state, CROWD, 0.5)[0]
    course = course / course.norm()
    ahead, far = (course * 1.0)[None], (course * 100.0)[None]
    state = replace(state, heading=course[None])
    for model, gives_way in ((CROWD, True), (DriftingFlock(), False)):
        step = FLOCK_MODELS['crowd' if gives_way else 'drifting'].step
        blocked = step(replace(state, shepherds=ahead), model, 0.5)[0] @ course
        free = step(replace(state, shepherds=far), model, 0.5)[0] @ course
        assert (blocked < free - 0.05).all() == gives_way
        assert torch.equal(blocked, free) != gives_way


def test_drifting_obstacles_keep_their_line_and_reflect_at_the_walls() -> None:
    config = DriftingFlock(square=10.0)
    state = replace(make_state(3, 30, 1, spread=1.0), step=torch.tensor(0))
    state = replace(state, sheep=state.sheep - state.sheep.mean(dim=0))
    for _ in range(400):
        sheep, heading = drifting_step(state, config, 0.5)
        assert (sheep.abs() <= 5 + 1e-5).all()
        assert torch.equal(heading.abs(), state.heading.abs())
        moved = torch.linalg.vector_norm(sheep - state.sheep, dim=-1)
        assert (moved <= 0.25 + 1e-5).all()
        speed = [
            0.2 + 0.3 * draw(state, int(state.step) // 2, Stream.PEDESTRIAN_SPEED, i)
            for i in range(30)
        ]
        straight = (heading == state.heading).all(dim=-1)
        assert torch.allclose(
            moved[straight], 0.5 * torch.tensor(speed).to(moved)[straight], atol=1e-5
        )
        state = replace(state, step=state.step + 1, sheep=sheep, heading=heading)
