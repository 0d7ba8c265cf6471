"""Noise or not, what happens over topics is what env.step does, bit by bit."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby
from typing import Any

from nodes.process import (
    assert_same_states,
    BEST_EFFORT,
    Graph,
    nanoseconds,
    rollout,
    Track,
)
import numpy as np
import pytest
from sensor_msgs.msg import LaserScan
from shepherd_ros.sim.lidar import LidarConfig, scan
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS
from shepherd_ros.sim.metrics import METRICS
from shepherd_ros.sim.perception import perceive
from shepherd_ros.sim.presets import training_world, world_preset
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.world import WorldConfig
from std_msgs.msg import Float64
import torch

STEPS = 50


def world_of(flock: str = 'strombom', **changes: Any) -> WorldConfig:
    """Return the world that flock_sim has with these parameters."""
    return replace(world_preset('default', flock), **({'episode_steps': STEPS} | changes))


def run_whole(
    graph: Graph, track: Track, states: list[WorldState], last: str, **parameters: Any
) -> None:
    """Start the controller last, when nothing can be missed, and compare every state."""
    graph.until(lambda: track.stamps, 'the first state')
    graph.start(last, **parameters)
    graph.until(lambda: len(track.stamps) >= len(states), f'{len(states)} states')
    assert_same_states(track, states)


@pytest.mark.parametrize(
    ('controller', 'flock', 'changes'),
    [
        pytest.param('strombom', 'reynolds', {}, marks=pytest.mark.system),
        ('pierson', 'strombom', {}),
        ('idle', 'strombom', {}),
        pytest.param('random', 'strombom', {}, marks=pytest.mark.system),
        ('drover', 'strombom', {'goal_speed': 0.2}),
        pytest.param(
            'strombom',
            'strombom',
            {'goal_speed': 0.1, 'goal_path': 'circle'},
            marks=pytest.mark.system,
        ),
    ],
)
def test_fifty_steps_over_topics_are_fifty_calls_of_env_step(
    graph: Graph, controller: str, flock: str, changes: dict[str, Any]
) -> None:
    states, _ = rollout(controller, EnvConfig(world=world_of(flock, **changes)))
    assert len(states) == STEPS + 1
    track = graph.track()
    graph.start('flock_sim', flock=flock, episode_steps=STEPS, episodes=1, **changes)
    run_whole(graph, track, states, controller)


def test_a_composite_over_topics_drives_and_holds_as_in_the_core(graph: Graph) -> None:
    options = {
        'drive': 'policy:strombom', 'hold': 'drover', 'home_within': 2.5, 'away_beyond': 4.0
    }  # fmt: skip
    config = EnvConfig(world=world_of())
    states, _ = rollout('composite', config, **options)
    alone, _ = rollout('composite', config, **options | {'home_within': 0.0})
    assert not torch.equal(states[-1].shepherds, alone[-1].shepherds)  # both had a turn
    assert torch.equal(states[1].shepherds, alone[1].shepherds)
    track = graph.track()
    graph.start('flock_sim', episode_steps=STEPS, episodes=1)
    run_whole(graph, track, states, 'composite', **options)


@pytest.mark.parametrize(
    ('noise_std', 'executor'),
    [(0.5, 'events'), pytest.param(0.0, 'single', marks=pytest.mark.system)],
)
def test_scans_and_metrics_over_topics_are_those_of_the_core(
    graph: Graph, noise_std: float, executor: str
) -> None:
    scans: dict[tuple[int, int], list[Any]] = {
        (h, c): graph.collect(f'shepherd_{h}/scan/{channel}', LaserScan, BEST_EFFORT)
        for h in range(3)
        for c, channel in enumerate(PAPER_CHANNELS)
    }
    values = {name: graph.collect(f'metrics/{name}', Float64) for name in METRICS}
    track = graph.track()
    graph.start('metrics', executor=executor)
    graph.start('lidar', executor=executor, shepherd_ids=[0, 1, 2], noise_std=noise_std)
    topics = [f'shepherd_{h}/scan/{c}' for h in range(3) for c in PAPER_CHANNELS]
    topics += [f'metrics/{name}' for name in METRICS]
    graph.until(lambda: all(map(graph.node.count_publishers, topics)), 'lidar and metrics')
    graph.start(
        'flock_sim', executor=executor, wait_for_scans=True, episode_steps=STEPS, episodes=1
    )
    states, metrics = rollout('strombom', EnvConfig(noise_std=noise_std, world=world_of()))

    def newest(received: list[LaserScan]) -> int:
        return nanoseconds(received[-1].header.stamp) if received else 0

    # step by step, as scans are best effort: what a slow probe has lost is shown again
    for k in range(len(states)):
        graph.until(
            lambda k=k: len(track.stamps) > k and set(map(newest, scans.values())) == {track.last},
            f'scans of state {k}',
        )
        if k < STEPS:
            assert graph.trigger('flock_sim/step') == '1 steps, then paused'
        if k == 0:
            graph.start('strombom', executor=executor, noise_std=noise_std)
    assert_same_states(track, states)

    expected_rows = [tuple(float(row[name]) for name in METRICS) for row in metrics]

    def rows() -> list[tuple[float, ...]]:
        """Return the metrics as published; those of a state that was shown again count once."""
        received = zip(*values.values(), strict=False)
        return [key for key, _ in groupby(tuple(m.data for m in row) for row in received)]

    graph.until(lambda: len(rows()) == len(states), 'metrics of every state')
    assert rows() == expected_rows
    for (h, c), received in scans.items():
        ranges = {
            nanoseconds(m.header.stamp): np.frombuffer(m.ranges, np.float32) for m in received
        }
        assert sorted(ranges) == track.stamps
        for ns, state in zip(track.stamps, states, strict=True):
            expected = scan(perceive(state, noise_std), LidarConfig())[h, c].numpy()
            assert np.array_equal(ranges[ns], expected), f'{h} {PAPER_CHANNELS[c]} at {ns}'


@pytest.mark.parametrize('controller', ['strombom', 'pierson'])
def test_episodes_in_a_row_are_those_of_the_environment_and_the_process_then_exits_zero(
    graph: Graph, controller: str
) -> None:
    states, _ = rollout(controller, EnvConfig(world=world_of(episode_steps=12)), 7, episodes=3)
    assert [int(state.seed) for state in states[::13]] == [7, 8, 9]
    track = graph.track()
    sim = graph.start('flock_sim', seed=7, episode_steps=12, episodes=3)
    run_whole(graph, track, states, controller)
    assert sim.wait() == 0, sim
    assert '3 episodes done' in sim.text
    graph.spin()
    assert track.last == track.stamps[len(states) - 1]


@pytest.mark.parametrize('controller', ['strombom', 'pierson'])
def test_teams_of_varying_size_and_goals_are_those_of_the_environment(
    graph: Graph, controller: str
) -> None:
    world = replace(training_world(world_of()), n_sheep=20, episode_steps=8)
    parameters = {
        'n_sheep': 20, 'n_shepherds': 6, 'spawn.fewest_shepherds': 1,
        'spawn.goal_radius_extra': 4.0, 'episode_steps': 8, 'episodes': 5,
    }  # fmt: skip
    track = graph.track()
    graph.host('flock_sim', **parameters)
    graph.host(controller, noise_std=0.2)
    states, _ = rollout(controller, EnvConfig(noise_std=0.2, world=world), episodes=5)
    assert len({int(state.team_size) for state in states}) > 2
    graph.until(lambda: len(track.stamps) == len(states), 'every state')
    assert_same_states(track, states)


def test_the_same_seed_gives_the_same_run_and_another_seed_another(graph: Graph) -> None:
    def run(seed: int) -> list[bytes]:
        track = graph.track()
        nodes = [
            graph.host('flock_sim', seed=seed, n_sheep=30, episode_steps=20, episodes=1),
            graph.host('strombom', noise_std=0.5),
        ]
        graph.until(lambda: nodes[0].finished, 'the episode ends')
        graph.until(lambda: len(track.stamps) == 21, 'every state')
        graph.forget(track)
        for node in nodes:
            graph.end(node)
        return [raw for side in track.halves.values() for _, raw in sorted(side.items())]

    first, again, other = run(3), run(3), run(4)
    assert first == again
    assert all(a != b for a, b in zip(first, other, strict=True))


def test_float32_positions_survive_the_way_through_float64_unchanged() -> None:
    bits = torch.randint(-(2**31), 2**31 - 1, (100_000,), dtype=torch.int64).to(torch.int32)
    numbers = bits.view(torch.float32)
    numbers = numbers[numbers.isfinite()]
    assert torch.equal(numbers.double().float(), numbers)
