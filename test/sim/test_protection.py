"""Payload protection: its start, its ends, its reward and metrics, by hand and in loops."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest
from reference import state_of
from shepherd_ros.config import ConfigError
from shepherd_ros.controllers import make_controller
from shepherd_ros.controllers.escorts import InterceptController
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.presets import world_preset
from shepherd_ros.sim.reward import reward_terms, RewardConfig
from shepherd_ros.sim.rollout import advance, EnvConfig, start
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.tasks import TASKS
from shepherd_ros.sim.tasks.protection import Protection
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor

WORLD = replace(world_preset(task='protection'), n_shepherds=3)
SEEDS = torch.arange(40)
IDLE = torch.zeros(3, 2)


def distance(points: Tensor, center: Tensor) -> Tensor:
    return torch.linalg.vector_norm(points - center[..., None, :], dim=-1)


def test_a_world_keeps_its_task_in_plain_data_and_herding_has_none_there() -> None:
    assert (
        WorldConfig.from_dict(WORLD.to_dict()) == WORLD == WorldConfig.from_dict(WORLD.changes())
    )
    assert WORLD.to_dict()['task'] == {
        'name': 'protection',
        'square': 50.0,
        'payload_distance': 20.0,
        'escort_gap': 1.0,
        'clearance': 3.0,
    }
    wide = WORLD.with_values({'task.square': 80.0})
    assert WorldConfig.from_dict(wide.to_dict()).task == Protection(square=80.0)
    assert not {'task', 'goal_speed'} & {*WorldConfig().to_dict(), *WorldConfig().changes()}
    with pytest.raises(ConfigError, match="task is 'protectoin': expected one of herding, prot"):
        WorldConfig.from_dict({'task': {'name': 'protectoin'}})


def test_the_payload_starts_opposite_to_its_destination_with_free_ground_around_it() -> None:
    spread = replace(WORLD.spawn, goal_radius_extra=1.5, fewest_shepherds=1)
    state = spawn(replace(WORLD, spawn=spread), SEEDS)
    assert torch.equal(state.goal, -state.destination)
    assert torch.allclose(torch.linalg.vector_norm(state.goal, dim=-1), torch.full((40,), 20.0))
    assert (state.sheep.abs() <= 25).all()
    assert (state.gap > 3).all()
    assert 2 <= float(state.goal_radius.min()) < float(state.goal_radius.max()) <= 3.5
    assert set(state.team_size.tolist()) == {1, 2, 3}
    ring = distance(state.shepherds, state.goal) - state.goal_radius[:, None]
    assert (ring[state.shepherd_mask] >= 1 - 1e-4).all()
    assert torch.equal(
        state.shepherds[~state.shepherd_mask],
        state.goal[:, None].expand(-1, 3, 2)[~state.shepherd_mask],
    )
    whole = state.world(state.team_size == 3)
    offset = whole.shepherds - whole.goal[:, None]
    angle = torch.atan2(offset[..., 1], offset[..., 0]).sort(dim=-1).values
    assert torch.allclose(angle.diff(dim=-1), torch.full_like(angle[:, 1:], 2 * math.pi / 3))


def test_pedestrians_without_a_free_place_start_in_the_far_corner() -> None:
    crowded = replace(WORLD, task=Protection(clearance=1000.0))
    state = spawn(crowded, SEEDS)
    assert (state.sheep.abs() == 25).all()
    assert (state.sheep * state.goal[:, None] <= 0).all()


def placed(*sheep: tuple[float, float], to: tuple[float, float] = (9.0, 0.0)) -> WorldState:
    """Return a payload of 2 m at 0, 0 on its way, with pedestrians and an escort."""
    state = state_of(sheep, [(3.0, 0.0)], goal_radius=2.0)
    return replace(state, destination=torch.tensor(to, dtype=torch.float64))


@pytest.mark.parametrize(
    ('state', 'ends', 'terms'),
    [
        (placed((5.5, 0.0)), False, (0.0, 0.0, 0.0, 0.0)),
        (placed((3.5, 0.0), (0.0, -4.25)), False, (0.0, -0.1 * (0.5 + 0.25) / 200, 0.0, 0.0)),
        (placed((2.0, 0.0)), False, (-10 / 200, -0.1 / 200, 0.0, 0.0)),
        (placed((1.5, 0.0), (0.0, 1.5)), False, (-0.05, -0.1 * 2 * (1 + 0.5 / 3) / 200, 0.0, 0.0)),
        (placed((0.75, 0.0)), True, (-0.05, -0.1 * (1 + 1.25 / 3) / 200, -2.0, 0.0)),
        (placed((9.0, 0.0), to=(0.0, 0.0)), True, (0.0, 0.0, 0.0, 5.0)),
        (placed((0.0, 0.0), to=(0.0, 0.0)), True, (-0.05, -0.1 * (1 + 2 / 3) / 200, -2.0, 5.0)),
    ],
)
def test_ends_and_rewards_are_those_of_the_numbers(
    state: WorldState, ends: bool, terms: tuple[float, ...]
) -> None:
    task = Protection()
    assert bool(task.terminated(state)) == ends
    computed = reward_terms(state, RewardConfig(), 200, names=task.terms)
    assert list(computed) == ['breach', 'nearness', 'collision', 'arrival']
    assert [float(term) for term in computed.values()] == pytest.approx(list(terms), abs=1e-12)
    strayed = reward_terms(state, RewardConfig(others=(('stray', -2.0),)), 200, names=task.terms)
    assert float(strayed['stray']) == pytest.approx(-2 * (3 - 2) / 200)
    heavier = RewardConfig(others=(('breach', -40.0),))
    assert float(reward_terms(state, heavier, 200, names=task.terms)['breach']) == pytest.approx(
        4 * terms[0]
    )


def test_one_pedestrian_at_a_payload_that_stands_breaches_as_one_sheep_occupies() -> None:
    world = replace(WORLD, n_sheep=1, goal_speed=0.0)
    moment = start(spawn(world, SEEDS), EnvConfig(world=world))
    inside = 0
    for _ in range(300):
        moment = advance(moment, IDLE.expand(40, 3, 2))
        steps = world.episode_steps
        herding = reward_terms(moment.state, RewardConfig(), steps)['occupancy']
        own = reward_terms(moment.state, RewardConfig(), steps, names=('breach',))['breach']
        assert torch.equal(own, -herding)
        inside += int((own < 0).sum())
    assert inside > 0
    assert torch.equal(moment.state.goal, spawn(world, SEEDS).goal)


def test_worlds_that_have_ended_stay_as_they_are_until_they_begin_anew() -> None:
    config = EnvConfig(world=WORLD)
    moment = start(spawn(WORLD, SEEDS), config)
    ends: dict[int, tuple[int, WorldState, dict[str, Tensor], float]] = {}
    total = torch.zeros(40)
    for step in range(1, 300):
        moment = advance(moment, IDLE.expand(40, 3, 2))
        total += moment.reward
        for b in moment.ended.nonzero()[:, 0].tolist():
            values = {name: value[b] for name, value in moment.metrics().items()}
            ends.setdefault(b, (step, moment.state.world(b), values, float(total[b])))
    assert len(ends) == 40
    for b, (step, state, values, gained) in ends.items():
        assert int(moment.state.step[b]) == step == values['steps_survived']
        assert torch.equal(moment.state.sheep[b], state.sheep)
        assert float(total[b]) == gained
        assert all(torch.equal(moment.metrics()[name][b], v) for name, v in values.items())
        arrived = bool((state.goal == state.destination).all())
        assert arrived == (step >= 240)  # 40 m at 1/3 m/s in steps of 0.5 s, and a rounded rest
        assert bool(values['success']) == (
            arrived and not bool(distance(state.sheep, state.goal).min() <= 0.75)
        )
    steps = [step for step, *_ in ends.values()]
    assert min(steps) < 240 <= max(steps) <= 241


def test_the_environment_tells_terminal_states_and_begins_anew_in_the_same_step() -> None:
    world = replace(WORLD, episode_steps=200, n_sheep=60)
    env = ShepherdEnv(EnvConfig(world=world), 30, lidar=False)
    env.reset(5)
    limits = terminal = 0
    for _ in range(260):
        before = env.state
        _, reward, terminated, truncated, info = env.step(torch.zeros_like(env.state.shepherds))
        assert not (terminated & truncated).any()
        ended = terminated | truncated
        if ended.any():
            final = info['final_state']
            assert torch.equal(world.task.terminated(final), terminated)
            assert torch.equal(final.step[ended], before.step[ended] + 1)
            assert (final.step[truncated] == 200).all()
            assert (env.state.step[ended] == 0).all()
            assert not world.task.terminated(env.state).any()
            assert (reward[terminated] < -1.9).all()  # nobody arrives within 200 steps
        limits, terminal = limits + int(truncated.sum()), terminal + int(terminated.sum())
    assert limits > 0
    assert terminal > 0


def test_metrics_are_those_of_loops_over_the_states() -> None:
    law = make_controller('block', WORLD)
    for seed in (2, 4):
        moment = start(spawn(WORLD, torch.tensor([seed])), EnvConfig(world=WORLD))
        memory, states = law.begin(moment.perceived), [moment.state.world(0)]
        while not moment.ended.all():
            command, memory = law.act(moment.perceived, memory)
            moment = advance(moment, command)
            states.append(moment.state.world(0))
        computed = {name: float(value[0]) for name, value in moment.metrics().items()}
        gaps = [(distance(s.sheep, s.goal) - s.goal_radius).numpy() for s in states]
        last = states[-1]
        arrived = bool((last.goal == last.destination).all())
        success = float(arrived and float(gaps[-1].min()) > 0.75 - 2.0)
        clean = success * float(all(gap.min() > 0 for gap in gaps))
        path = sum(
            float(torch.linalg.vector_norm(b.shepherds - a.shepherds, dim=-1).mean())
            for a, b in zip(states, states[1:], strict=False)  # noqa: RUF007
        )
        payload = sum(
            float(torch.linalg.vector_norm(b.goal - a.goal))
            for a, b in zip(states, states[1:], strict=False)  # noqa: RUF007
        )
        far = [float(distance(s.shepherds, s.goal).mean()) for s in states[1:]]
        assert computed == pytest.approx(
            {
                'success': success,
                'clean_success': clean,
                'breach_share': np.mean([gap.min() <= 0 for gap in gaps[1:]]),
                'intruders': float((np.stack(gaps) <= 0).any(axis=0).sum()),
                'smallest_gap': min(gap.min() for gap in gaps),
                'steps_survived': len(states) - 1,
                'shepherd_path_length': path,
                'path_per_payload_meter': path / payload,
                'payload_distance': np.mean(far),
                'gap': gaps[-1].min(),
            },
            abs=1e-3,
        )


def test_rings_wedges_and_blocks_stand_where_they_should() -> None:
    state = spawn(replace(WORLD, n_sheep=1), SEEDS)
    far = state.goal[:, None] * 5
    approaching = state.goal[:, None] + 6 * torch.tensor([0.0, 1.0])
    state = replace(state, sheep=approaching, heading=torch.tensor([0.0, -1.0]).expand(40, 1, 2))
    quick = replace(WORLD, shepherd_speed=1000.0, n_sheep=1)
    course = state.destination / 20
    following = state.goal + course * (0.5 / 3)

    def places(name: str, seen: WorldState) -> Tensor:
        """Return the places after a step without a limit of speed, relative to the payload."""
        law = make_controller(name, quick)
        return seen.shepherds + law.act(seen, {})[0] * 0.5 - following[:, None]

    for name in ('ring', 'wedge', 'block'):
        assert torch.allclose(
            torch.linalg.vector_norm(places(name, state), dim=-1), torch.tensor(3.5), atol=1e-3
        )
    assert torch.allclose(places('ring', state).sum(dim=1), torch.zeros(40, 2), atol=1e-2)
    along = (places('wedge', state) @ course[..., None])[..., 0].sort(dim=-1).values
    wedge = torch.tensor([1.75, 1.75, 3.5])  # cos 60, cos 60 and cos 0 of 3.5 m
    assert torch.allclose(along, wedge.expand(40, 3), atol=1e-2)
    to = approaching[:, 0] - following
    to = 3.5 * to / torch.linalg.vector_norm(to, dim=-1, keepdim=True)
    gap = torch.linalg.vector_norm(places('block', state) - to[:, None], dim=-1)
    assert (gap.amin(dim=-1) < 1e-2).all()
    assert ((gap < 1e-2).sum(dim=-1) == 1).all()
    leaving = replace(state, sheep=far, heading=state.goal[:, None] / 20)
    assert torch.equal(places('block', leaving), places('ring', leaving))


@pytest.mark.parametrize('name', ['ring', 'wedge', 'block', 'huddle', 'intercept'])
def test_escorts_of_a_batch_command_as_alone_and_the_absent_stand(name: str) -> None:
    world = replace(WORLD, n_shepherds=4, spawn=replace(WORLD.spawn, fewest_shepherds=1))
    state, law = spawn(world, SEEDS), make_controller(name, world)
    command, _ = law.act(state, {})
    assert (torch.linalg.vector_norm(command, dim=-1) <= 1 + 1e-5).all()
    assert (command[~state.shepherd_mask] == 0).all()
    for b in range(0, 40, 7):
        assert torch.equal(command[b], law.act(state.world(b), {})[0])


def test_the_tasks_are_known_by_name() -> None:
    assert [*TASKS][:2] == ['herding', 'protection']
    assert TASKS['protection'].metrics is not TASKS['herding'].metrics


def test_an_interception_meets_the_pedestrian_that_arrives_next() -> None:
    world = replace(WORLD, n_shepherds=1, n_sheep=3, goal_speed=0.0, shepherd_speed=1000.0)
    law = make_controller('intercept', world)
    assert isinstance(law, InterceptController)
    at, to = [(0.0, 4.4), (-4.0, 0.0), (4.0, 4.0)], [(0.0, -1.0), (1.0, 0.0), (1.0, 0.0)]
    state = replace(placed(*at), heading=torch.tensor(to, dtype=torch.float64))
    times = law.arrival(state, state.goal)  # at 0.35 m/s, to 1.2 m from a region of 2 m
    assert times.tolist() == pytest.approx([(4.4 - 3.2) / 0.35, (4 - 3.2) / 0.35, math.inf])

    def place(seen: WorldState) -> list[float]:
        return (seen.shepherds + law.act(seen, {})[0] * 0.5)[0].tolist()

    assert place(state) == pytest.approx([-(4 - 0.9), 0.0])
    near = replace(state, sheep=state.sheep * 0.4)
    first, second, _ = law.arrival(near, near.goal).tolist()  # 1.8 and 1.6 m from the middle
    assert second < first < 0
    away = replace(state, heading=-state.heading)
    assert law.arrival(away, away.goal).tolist() == [math.inf, math.inf, math.inf]
    assert place(away) == pytest.approx([0.0, 0.0])  # the middle of the payload
    moving = replace(world, goal_speed=1 / 3)
    law = InterceptController(law.config, moving)
    payload = torch.tensor([0.5 / 3, 0.0])  # it moves to the right, the pedestrian goes up
    crossing = replace(placed((4.0, -2.0)), heading=torch.tensor([[0.0, 1.0]]).double())
    (time,) = law.arrival(crossing, payload).tolist()
    met_at = torch.tensor([4 - 0.5 / 3 - time / 3, -2 + 0.35 * time])
    assert float(met_at.norm()) == pytest.approx(3.2)
    assert 0 < time < 4
