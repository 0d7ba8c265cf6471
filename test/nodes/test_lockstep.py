"""Lockstep: the world moves when everybody has answered, whoever comes first, last or again."""

from __future__ import annotations

from collections.abc import Callable
import re
from signal import SIGCONT, SIGSTOP
from typing import Any

from nodes.process import assert_same_states, Graph, LATCHED, Process, rollout, Track
import pytest
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.wire.episode import Episode
from std_msgs.msg import String
from std_srvs.srv import SetBool

STEPS = 30
SMALL: dict[str, Any] = {'n_sheep': 20, 'n_shepherds': 2, 'episode_steps': STEPS, 'episodes': 1}
QUICK: dict[str, Any] = {'resend_period': 0.05, 'silence_warning': 0.5}


def assert_episode_is_that_of_the_core(track: Track) -> None:
    """Assert that no step was lost, made twice or made with another command."""
    world = WorldConfig(n_sheep=20, n_shepherds=2, episode_steps=STEPS)
    states, _ = rollout('strombom', EnvConfig(world=world))
    assert_same_states(track, states)


def whole(track: Track) -> bool:
    """Return whether every state of the episode was heard."""
    return len(track.stamps) > STEPS


def assert_stands(graph: Graph, track: Track) -> None:
    """Assert that the same state is shown again and again, and no other."""
    graph.until(lambda: len(set(track.shown[-3:])) == 1, 'nothing is on its way any more')
    now, times = track.last, len(track.shown)
    graph.until(lambda: len(track.shown) > times + 3, 'the state is shown again')
    assert track.last == now
    assert set(track.shown[times:]) == {now}


@pytest.mark.parametrize('last', ['flock_sim', 'lidar', 'strombom'])
def test_nodes_start_in_any_order(graph: Graph, last: str) -> None:
    nodes = {
        'flock_sim': {**SMALL, 'wait_for_scans': True},  # so that the lidar matters, too
        'lidar': {'shepherd_ids': [0, 1]},
        'strombom': {},
    }
    track = graph.track()
    for name in nodes.keys() - {last}:
        graph.host(name, **nodes[name])
    graph.until_nodes(*(nodes.keys() - {last}))
    if last != 'flock_sim':
        graph.until(lambda: track.stamps, 'the first state')
        assert_stands(graph, track)
    node = graph.host(last, **nodes[last])
    if last == 'flock_sim':  # we may hear none of it, as nobody waits for us
        graph.until(lambda: node.finished, 'the whole episode')
    else:
        graph.until(lambda: whole(track), 'the whole episode')
        assert_episode_is_that_of_the_core(track)


def test_a_silent_shepherd_is_named_and_the_episode_goes_on_when_it_answers(graph: Graph) -> None:
    track = graph.track()
    sim = graph.start('flock_sim', **SMALL, **QUICK)
    team = ['shepherd_0/cmd_vel', 'shepherd_1/cmd_vel']
    both = re.escape('; '.join(f'{name} (nobody publishes it)' for name in team))
    graph.until_says(sim, rf'\[WARN\].* waiting at 0\.500 s for {both}')
    graph.until_status('flock_sim: commands', f'no answer on {", ".join(team)}')
    graph.start('strombom', shepherd_ids=[0])
    graph.until_says(sim, r'\[flock_sim\]: shepherd_0/cmd_vel: answering again')
    status = graph.until_status('flock_sim: commands', 'no answer on shepherd_1/cmd_vel')
    assert status.level == status.ERROR
    assert 'shepherd_0' not in status.message
    assert_stands(graph, track)
    graph.start('strombom', '-r', '__node:=second', shepherd_ids=[1])
    graph.until_says(sim, r'\[flock_sim\]: shepherd_1/cmd_vel: answering again')
    graph.until(lambda: whole(track), 'the whole episode')
    assert_episode_is_that_of_the_core(track)


def run_until(graph: Graph, stop: Callable[[Process], None]) -> tuple[Track, Process, Process]:
    """Start a world and its controller, stop that one after five steps; let the world go on."""
    track = graph.track()
    sim = graph.start('flock_sim', **SMALL, **QUICK)
    graph.until(lambda: track.stamps, 'the first state')
    graph.steps(5)  # so that it cannot be over before it is stopped
    controller = graph.start('strombom')
    graph.until(lambda: len(track.stamps) > 5, 'five steps')
    stop(controller)
    assert graph.call('flock_sim/pause', SetBool, SetBool.Request(data=False)).success
    # the command of shepherd_0 may have come out just before
    graph.until_says(sim, r'waiting at [^0].* shepherd_1/cmd_vel')
    assert_stands(graph, track)
    assert 5 < len(set(track.shown)) <= 7
    return track, sim, controller


def test_a_stopped_controller_is_named_and_goes_on_where_it_was(graph: Graph) -> None:
    track, sim, controller = run_until(graph, lambda process: process.send(SIGSTOP))
    assert sim.says(r'waiting at [^0].* shepherd_1/cmd_vel \(/strombom\)')
    graph.until_status('flock_sim: commands', 'no answer on .*shepherd_1/cmd_vel')
    controller.send(SIGCONT)
    graph.until(lambda: whole(track), 'the whole episode')
    assert_episode_is_that_of_the_core(track)
    assert 'answering again' in sim.text


def test_a_killed_controller_is_named_and_a_new_one_takes_its_place(graph: Graph) -> None:
    track, _, _ = run_until(graph, Process.kill)
    graph.start('strombom')
    graph.until(lambda: whole(track), 'the whole episode')
    assert_episode_is_that_of_the_core(track)


def test_a_world_that_waits_for_scans_names_the_missing_lidar(graph: Graph) -> None:
    track = graph.track()
    graph.listen_to_logs()
    graph.host('flock_sim', wait_for_scans=True, **SMALL, **QUICK)
    graph.host('strombom')
    lidar = graph.host('lidar', shepherd_ids=[1])
    graph.until(
        lambda: graph.warnings(r'waiting at 0\.500 s for .*shepherd_0/scan/sheep \(nobody'),
        'the missing lidar is named',
    )
    graph.until_status(
        'flock_sim: commands',
        'no answer on ' + ', '.join(f'shepherd_0/scan/{c}' for c in PAPER_CHANNELS),
    )
    assert_stands(graph, track)
    other = graph.host('lidar', '-r', '__node:=other', shepherd_ids=[0])
    graph.until(lambda: whole(track), 'the whole episode')
    assert_episode_is_that_of_the_core(track)
    graph.until(
        lambda: min(lidar.listener.states, other.listener.states) > STEPS, 'scans of every state'
    )


def test_a_world_does_not_wait_for_scans_unless_told(graph: Graph) -> None:
    track = graph.track()
    graph.host('flock_sim', **SMALL)
    graph.host('strombom')
    graph.until(lambda: whole(track), 'the whole episode without any lidar')


def test_nodes_that_join_a_paused_world_late_get_its_state(graph: Graph) -> None:
    sim = graph.host('flock_sim', n_sheep=20, n_shepherds=2)
    idle = graph.host('idle')
    graph.until(lambda: int(sim.state.step) > 3, 'a few steps')
    sim.pacing.paused = True
    graph.until(lambda: sim.flock_commands.complete, 'all answers to the state that stands')
    step = int(sim.state.step)
    track = graph.track()
    lidar, metrics = graph.host('lidar'), graph.host('metrics')
    graph.until(
        lambda: track.stamps and lidar.listener.states and metrics.listener.states,
        'the state for all who joined late',
    )
    assert track.stamps == [sim.now_ns]
    assert int(sim.state.step) == step
    assert int(metrics.moment.state.step) == step
    graph.until_status('metrics: metrics', 'states of this episode were missed')
    graph.end(idle)


def test_nodes_that_join_a_running_world_late_follow_from_there(graph: Graph) -> None:
    sim = graph.host('flock_sim', n_sheep=20, n_shepherds=2)
    graph.host('idle')
    graph.until(lambda: int(sim.state.step) > 3, 'a few steps')
    metrics = graph.host('metrics')
    graph.until(lambda: metrics.listener.states > 5, 'states for who joined late')
    assert metrics.listener.episode == sim.episode
    assert int(metrics.moment.state.step) > 5


def test_a_world_goes_on_after_its_nodes_were_told_of_another_episode(graph: Graph) -> None:
    track = graph.track()
    sim = graph.start('flock_sim', **(SMALL | {'episode_steps': 100_000}), **QUICK)
    graph.start('strombom')
    graph.until(lambda: len(track.stamps) > 100, 'everybody answers')
    other = Episode(9, 9, 10**15, 3, 1, 4.0, 'map', 'lockstep', WorldConfig().to_dict())
    foreign = graph.publisher('episode', String, LATCHED)
    graph.until_says(sim, '/episode is published by 2 nodes')  # it repeats what it says, once
    foreign.publish(String(data=other.to_json()))
    # the answer of shepherd_0 may have come out just before
    graph.until_says(sim, r'waiting at [^0].* shepherd_\d/cmd_vel')
    graph.until_says(sim, 'answering again')
    seen = track.last
    graph.until(lambda: track.last > seen, 'the world goes on')
