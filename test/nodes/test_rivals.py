"""Rival publishers of the world and silent nodes are named, by all."""

from __future__ import annotations

from itertools import pairwise
import math
from types import SimpleNamespace
from typing import Any

from geometry_msgs.msg import PoseStamped, TwistStamped
from nodes.process import BEST_EFFORT, Graph, LATCHED, nanoseconds
import pytest
from sensor_msgs.msg import LaserScan
from shepherd_ros.nodes.flock_pacing import Pacing
from shepherd_ros.ros.node import UNKNOWN_NODE_NAME

SMALL: dict[str, Any] = {'n_sheep': 5, 'n_shepherds': 1}


def goal_at(x: float) -> PoseStamped:
    """Return a goal that nobody asked for."""
    pose = PoseStamped()
    pose.header.frame_id, pose.pose.position.x = 'map', x
    return pose


def test_two_worlds_on_the_same_topics_are_named_by_all_who_hear_them(graph: Graph) -> None:
    graph.listen_to_logs()
    graph.host('flock_sim', **SMALL)
    graph.host('metrics', use_sim_time=True)
    other = graph.host('flock_sim', '-r', '__node:=other', **SMALL)
    for name in ('flock_sim', 'metrics', 'other'):
        status = graph.until_status(
            f'{name}: inputs', 'several nodes publish /clock, .*/flock/poses'
        )
        assert status.level == status.ERROR
    pattern = r'/flock/poses is published by 2 nodes \(/flock_sim, /other\), expected one: stop'
    graph.until(lambda: len(graph.warnings(pattern)) == 3, 'each says it once')
    graph.end(other)
    graph.until_status('flock_sim: inputs', 'every message can be read')


def test_a_stranger_that_moves_the_goal_is_named_and_put_right(graph: Graph) -> None:
    graph.listen_to_logs()
    # neither the next episode nor a silent shepherd makes the world say its goal again
    sim = graph.host('flock_sim', episode_steps=10**6, silence_warning=1000.0, **SMALL)
    controller = graph.host('strombom')
    graph.until(lambda: controller.listener.states > 3, 'the world moves')
    stranger = graph.publisher('goal', PoseStamped, LATCHED)
    stranger.publish(goal_at(math.nan))
    graph.until(lambda: graph.warnings('goal is nan, 0.0: expected finite numbers'), 'refused')
    assert controller.listener.goal.tolist() == sim.state.goal.tolist()
    graph.until(lambda: graph.warnings('/goal is published by .*/probe'), 'the stranger is named')
    rivals = {'/goal': ['/flock_sim', '/probe']}
    graph.until(lambda: sim.rivals == rivals, 'the world has found it, and says its goal again')
    stranger.publish(goal_at(500.0))
    graph.until(lambda: controller.listener.goal.tolist() == [500.0, 0.0], 'it is believed')
    graph.node.destroy_publisher(stranger)
    graph.until(
        lambda: not sim.rivals and controller.listener.goal.tolist() == sim.state.goal.tolist(),
        'the goal of the world again',
    )


def test_commands_that_are_not_finite_are_a_warning_on_diagnostics(graph: Graph) -> None:
    sim = graph.host('flock_sim', **SMALL)
    command = TwistStamped()
    command.header.frame_id, command.twist.linear.x = 'map', math.inf
    command.header.stamp.nanosec = 500_000_000
    graph.until(lambda: sim.pacing.settled, 'the world may move')
    graph.publisher('shepherd_0/cmd_vel', TwistStamped).publish(command)
    status = graph.until_status('flock_sim: commands', 'commands that are not finite')
    assert status.level == status.WARN


def test_worlds_in_namespaces_share_one_clock_and_no_frame(graph: Graph) -> None:
    clock = graph.clock()
    scans = {
        space: graph.collect(f'{space}/shepherd_0/scan/goal', LaserScan, BEST_EFFORT)
        for space in ('/a', '/b')
    }
    watch = graph.host('metrics', '-r', '__ns:=/a', use_sim_time=True)
    for space in scans:
        sim = graph.host('flock_sim', '-r', f'__ns:={space}', publish_clock=space == '/a', **SMALL)
        for name in ('lidar', 'idle'):
            graph.host(name, '-r', f'__ns:={space}')
    graph.until(lambda: all(len(received) > 10 for received in scans.values()), 'both worlds')
    graph.until(lambda: len(graph.clock()) > 10, 'a clock')
    clock = graph.clock()
    assert all(a <= b for a, b in pairwise(clock)), 'no jump back'
    assert watch.get_clock().now().nanoseconds > 0
    for space, received in scans.items():
        assert {scan.header.frame_id for scan in received} == {f'{space[1:]}/shepherd_0'}
    assert nanoseconds(scans['/b'][-1].header.stamp) > 0
    assert not any(node.rivals for node in graph.hosted)
    assert sim.shepherd_frame == 'b/shepherd_{h}'


def test_a_dead_lidar_is_named_by_the_world_and_by_the_policy(graph: Graph) -> None:
    graph.listen_to_logs()
    graph.host('flock_sim', silence_warning=0.3, **SMALL)
    graph.host('policy')
    lidar = graph.host('lidar')
    graph.until(lambda: lidar.listener.states > 3, 'the world moves')
    graph.end(lidar)
    status = graph.until_status('policy: policy', r'waiting for shepherd_0/scan/sheep \(nobody')
    assert status.level == status.WARN
    graph.until(lambda: graph.warnings(r'waiting for shepherd_0/scan/sheep \(nobody'), 'said')
    chain = r'shepherd_0/cmd_vel \(/policy, by /shepherd_0/scan/goal \(nobody publishes it\)'
    graph.until_status('flock_sim: commands', chain)
    graph.publisher('shepherd_0/scan/goal', LaserScan)  # whose scans do not come
    for who in ('waiting at .*by /', 'waiting for .*'):  # the world and the policy say it again
        pattern = who + r'shepherd_0/scan/goal \(/probe\)'
        graph.until(lambda pattern=pattern: graph.warnings(pattern), pattern)
    assert not graph.warnings('_NODE_NAME_UNKNOWN_')


def test_listeners_say_that_the_world_is_gone(graph: Graph) -> None:
    sim, metrics = graph.host('flock_sim', **SMALL), graph.host('metrics')
    graph.host('idle')
    graph.until(lambda: metrics.listener.states > 3, 'the world moves')
    graph.end(sim)
    pattern = r'no state of the world for \d+ s: flock/poses \(nobody publishes it\)'
    for name in ('metrics: metrics', 'idle: controller'):
        assert graph.until_status(name, pattern).level == b'\1'


def test_a_rate_that_is_not_kept_is_told_and_a_jitter_is_not() -> None:
    pacing = Pacing(0.0)
    pacing.settled = True

    def report(now: float, made: int, wanted: float) -> str:
        for _ in range(made):
            assert pacing.may_move()
        return pacing.report(now, wanted)[1]

    assert report(1.0, 20, 20.0) == ''
    assert report(2.0, 9, 20.0) == '9 steps per second are made, expected 20'
    assert [report(3.0 + k, 20, 20.0) for k in range(20)][-1] == ''
    assert [report(23.0 + k, k % 2 * 2, 1.0) for k in range(10)] == [''] * 10
    assert 'expected 1' in [report(33.0 + k, k % 2, 1.0) for k in range(20)][-2]
    pacing.pause(True)
    assert report(60.0, 0, 20.0) == 'paused'


def test_a_publisher_that_has_no_name_yet_is_said_so(
    graph: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    sim = graph.host('flock_sim', **SMALL)
    unknown = SimpleNamespace(
        node_name=UNKNOWN_NODE_NAME, node_namespace='_NODE_NAMESPACE_UNKNOWN_'
    )
    monkeypatch.setattr(sim, 'get_publishers_info_by_topic', lambda topic: [unknown])
    reason = sim.flock_commands._reason('shepherd_0/cmd_vel')
    assert reason == 'shepherd_0/cmd_vel (a node not yet named)'
