"""Simulated time: nodes follow /clock, and it never jumps back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

from nodes.process import assert_same_states, Graph, rollout
import pytest
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock
from shepherd_ros.ros.node import stamp
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import WorldConfig
from std_srvs.srv import SetBool

SMALL: dict[str, Any] = {'n_sheep': 10, 'n_shepherds': 2}


@contextmanager
def watched_jumps(node: Any) -> Iterator[list[int]]:
    """Give the list into which the size [ns] of every jump back of a node's clock comes."""
    jumps: list[int] = []
    threshold = JumpThreshold(
        min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False
    )
    handle = node.get_clock().create_jump_callback(
        threshold, post_callback=lambda jump: jumps.append(jump.delta.nanoseconds)
    )
    yield jumps
    handle.unregister()


@pytest.mark.parametrize('executable', ['lidar', 'metrics', 'strombom', 'pierson'])
def test_a_node_with_use_sim_time_follows_the_clock_of_the_world(
    graph: Graph, executable: str
) -> None:
    sim = graph.host('flock_sim', **SMALL)
    graph.host('idle')
    node = graph.host(executable, '-r', '__ns:=/other', use_sim_time=True)
    clock = node.get_clock()
    graph.until(lambda: clock.now().nanoseconds > 3 * sim.dt_ns, 'its clock moves')
    graph.call('flock_sim/pause', SetBool, SetBool.Request(data=True))
    graph.until(lambda: clock.now().nanoseconds == sim.now_ns, 'its clock is that of the world')
    graph.idle(0.05)
    assert clock.now().nanoseconds == sim.now_ns  # it stands with the world
    graph.steps(4)
    graph.until(lambda: sim.pacing.steps_left == 0 and sim.flock_commands.complete, 'four steps')
    graph.until(lambda: clock.now().nanoseconds == sim.now_ns, 'its clock follows')
    graph.until_status(f'other/{executable}: ', '.')  # once a second of wall time all the same


def test_a_node_without_use_sim_time_has_the_time_of_the_machine(graph: Graph) -> None:
    graph.host('flock_sim', **SMALL)
    node = graph.host('lidar')
    assert node.get_clock().now().nanoseconds > 1_600_000_000 * 10**9


@pytest.mark.parametrize('mode', ['lockstep', 'realtime'])
def test_the_clock_never_jumps_back_over_episodes_and_resets(graph: Graph, mode: str) -> None:
    sim = graph.host('flock_sim', mode=mode, rate=100.0, episode_steps=4, **SMALL)
    graph.host('idle')
    lidar = graph.host('lidar', use_sim_time=True)
    track = graph.track()
    graph.clock()
    with watched_jumps(lidar) as jumps:
        graph.until(lambda: sim.number >= 3, 'three whole episodes')
        for seed in (0, 0, 7):
            number = sim.number
            graph.reset(seed)
            graph.until(lambda n=number: sim.number > n + 1, 'the episode after the reset')
        clock = graph.clock()
        assert len(clock) > 20
        assert clock == sorted(clock)
        assert track.shown == sorted(track.shown)
        assert {b - a for a, b in pairwise(sorted(set(track.shown)))} == {sim.dt_ns}
        assert jumps == []
        graph.end(sim)  # nobody else sets the clock: the watch would have seen it
        graph.publisher('/clock', Clock).publish(Clock(clock=stamp(1)))
        graph.until(lambda: jumps, 'a jump back')


def test_the_clock_comes_with_every_state_and_carries_its_stamp(graph: Graph) -> None:
    track = graph.track()
    graph.clock()
    sim = graph.host('flock_sim', dt=0.1, episode_steps=20, episodes=1, **SMALL)
    graph.until(lambda: track.stamps and graph.clock(), 'the first state')
    graph.host('idle')
    graph.until(lambda: sim.finished, 'the episode ends')
    graph.until(lambda: len(track.stamps) == 21, 'every state')
    graph.until(lambda: graph.clock()[-1] == track.last, 'the last clock')
    assert set(graph.clock()) == set(track.stamps)
    assert track.stamps == [100_000_000 * (k + 1) for k in range(21)]  # no rounding adds up


def test_the_whole_stack_runs_on_simulated_time_and_gives_the_same_states(graph: Graph) -> None:
    track = graph.track()
    parameters: dict[str, dict[str, Any]] = {
        'flock_sim': {'episode_steps': 20, 'wait_for_scans': True, **SMALL},
        'lidar': {'shepherd_ids': [0, 1]},
        'metrics': {},
    }
    for name, given in parameters.items():
        graph.host(name, use_sim_time=True, **given)
    graph.until(lambda: track.stamps, 'the first state')
    graph.host('strombom', use_sim_time=True)
    graph.until(lambda: len(track.stamps) > 20, 'a whole episode')
    states, _ = rollout('strombom', EnvConfig(world=WorldConfig(episode_steps=20, **SMALL)))
    assert_same_states(track, states, track.stamps[:21])


def test_realtime_is_wall_time_even_if_the_world_itself_is_told_to_use_its_own_clock(
    graph: Graph,
) -> None:
    track = graph.track()
    graph.host('flock_sim', mode='realtime', rate=50.0, use_sim_time=True, **SMALL)
    graph.until(lambda: len(track.stamps) > 20, 'the world moves')
    # a slow machine says how many steps it makes instead
    graph.until_status('flock_sim: episode', 'running|steps per second are made')
