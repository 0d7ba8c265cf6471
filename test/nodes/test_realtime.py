"""Realtime: a wall clock moves the world, and a watchdog stops shepherds that fall silent."""

from __future__ import annotations

from itertools import pairwise
import time
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
from nodes.process import Graph, twist
import pytest
from std_srvs.srv import SetBool
import torch

SMALL: dict[str, Any] = {'mode': 'realtime', 'n_sheep': 5, 'n_shepherds': 2}


def assert_held_back(graph: Graph, sim: Any, steps: int, seconds: float) -> None:
    """Assert that steps take no less time."""
    begun, start = int(sim.state.step), time.monotonic()
    graph.until(lambda: int(sim.state.step) >= begun + steps, f'{steps} steps')
    assert time.monotonic() - start > 0.8 * seconds  # less a period, as the first may be near


def assert_pace(graph: Graph, sim: Any, steps: int, seconds: float) -> None:
    """Assert that steps take no less time, and keep up with a timer in the same executor."""
    before, ticks = int(sim.state.step), []
    graph.until(lambda: int(sim.state.step) > before, 'a step')  # readers are waited for
    timer = graph.node.create_timer(seconds / steps, lambda: ticks.append(time.monotonic()))
    assert_held_back(graph, sim, steps, seconds)
    graph.node.destroy_timer(timer)
    assert len(ticks) < 1.2 * steps + 3


def paused_at(graph: Graph, sim: Any) -> int:
    """Pause a world, which then stands however slow the machine is; return its stamp [ns]."""
    assert graph.call('flock_sim/pause', SetBool, SetBool.Request(data=True)).success
    return int(sim.now_ns)


def test_the_world_keeps_its_rate_without_any_controller_and_takes_a_new_one(
    graph: Graph,
) -> None:
    sim = graph.host('flock_sim', rate=50.0, **SMALL)
    assert_pace(graph, sim, 50, 1.0)
    assert graph.set_parameter('flock_sim', 'rate', 200.0) == (True, '')
    assert_pace(graph, sim, 100, 0.5)
    assert graph.set_parameter('flock_sim', 'rate', 10.0) == (True, '')
    assert_pace(graph, sim, 10, 1.0)


def test_a_rate_of_zero_is_as_fast_as_the_simulated_clock(graph: Graph) -> None:
    track = graph.track()
    sim = graph.host('flock_sim', dt=0.02, **SMALL)
    assert sim.period == 0.02
    assert_pace(graph, sim, 50, 1.0)
    assert {b - a for a, b in zip(track.stamps, track.stamps[1:], strict=False)} == {20_000_000}


def test_a_rate_holds_a_world_in_lockstep_back_and_loses_no_step(graph: Graph) -> None:
    track = graph.track()
    sim = graph.host('flock_sim', n_sheep=5, n_shepherds=2, rate=20.0)
    graph.host('idle')
    assert_held_back(graph, sim, 20, 1.0)
    assert graph.set_parameter('flock_sim', 'rate', 0.0) == (True, '')
    fast = len(track.stamps) + 100
    graph.until(lambda: len(track.stamps) > fast, 'it goes as fast as it is answered')
    assert graph.set_parameter('flock_sim', 'rate', 40.0) == (True, '')
    assert_held_back(graph, sim, 20, 0.5)
    assert {b - a for a, b in pairwise(track.stamps)} == {sim.dt_ns}


def test_a_rate_given_as_an_integer_works(graph: Graph) -> None:
    sim = graph.host('flock_sim', rate=40, **SMALL)
    assert sim.period == 0.025
    assert_pace(graph, sim, 20, 0.5)
    graph.set_parameter('flock_sim', 'rate', 80.0)
    assert sim.period == 0.0125


def test_a_rate_that_cannot_be_is_refused_and_the_world_goes_on(graph: Graph) -> None:
    sim = graph.host('flock_sim', rate=50.0, **SMALL)
    for value, pattern in (
        (float('nan'), 'range'),
        (-1.0, 'range'),
        (1e9, 'range'),
        (1e-300, 'rate is 1e-300: expected 0, or at least'),
        ('fast', 'Wrong parameter type'),
        (20, 'Wrong parameter type'),
    ):
        taken, reason = graph.set_parameter('flock_sim', 'rate', value)
        assert not taken
        assert pattern in reason
    assert sim.rate == 50.0
    assert_pace(graph, sim, 20, 0.4)


@pytest.mark.parametrize(('watchdog_steps', 'moves'), [(3, 4), (0, 1)])
def test_the_watchdog_stops_a_shepherd_that_falls_silent(
    graph: Graph, watchdog_steps: int, moves: int
) -> None:
    track = graph.track()
    sim = graph.host('flock_sim', rate=50.0, watchdog_steps=watchdog_steps, **SMALL)
    publisher = graph.publisher('shepherd_0/cmd_vel', TwistStamped)
    graph.until_status('flock_sim: commands', 'stopped by the watchdog: shepherd_0, shepherd_1')
    answered = paused_at(graph, sim)
    publisher.publish(twist(answered, 0.8, 0.0))
    commands = sim.flock_commands.commands
    graph.until(lambda: commands.velocities[0] == (0.8, 0.0), 'the command is taken')
    graph.steps(watchdog_steps + 5)
    graph.until(lambda: track.last == answered + (watchdog_steps + 5) * sim.dt_ns, 'the steps')
    direction = [
        (track.shepherds(b) - track.shepherds(a))[0].tolist()
        for a, b in zip(track.stamps, track.stamps[1:], strict=False)
    ]
    moved = [k for k, step in enumerate(direction) if step != [0.0, 0.0]]
    assert [track.stamps[k] for k in moved] == [answered + k * sim.dt_ns for k in range(moves)]
    for k in moved:
        assert torch.allclose(torch.tensor(direction[k]), torch.tensor([0.4, 0.0]), atol=1e-5)
    status = graph.until_status('flock_sim: commands', 'stopped by the watchdog: shepherd_0')
    assert status.level == status.ERROR


def test_a_late_command_within_the_watchdogs_steps_counts_and_an_older_one_does_not(
    graph: Graph,
) -> None:
    sim = graph.host('flock_sim', rate=50.0, watchdog_steps=3, **SMALL)
    publisher = graph.publisher('shepherd_1/cmd_vel', TwistStamped)
    graph.until(lambda: int(sim.state.step) > 6, 'a few steps')
    now = paused_at(graph, sim)
    publisher.publish(twist(now - 4 * sim.dt_ns, 0.5, 0.0))
    graph.until(
        lambda: sim.flock_commands.counts['wrong_stamp'] == 1, 'the old command is refused'
    )
    commands = sim.flock_commands.commands
    assert commands.velocities[1] == (0.0, 0.0)
    publisher.publish(twist(now - 3 * sim.dt_ns, 0.5, 0.0))
    graph.until(lambda: commands.velocities[1] == (0.5, 0.0), 'the late command is taken')
    assert sim.flock_commands.counts['wrong_stamp'] == 1


def test_a_controller_keeps_up_and_none_of_its_commands_is_refused(graph: Graph) -> None:
    track = graph.track()
    graph.start('flock_sim', rate=20.0, **SMALL)
    graph.start('strombom')
    graph.until_status('flock_sim: commands', 'every shepherd answers')
    first = track.last
    graph.until(lambda: track.last > first + 10 * 500_000_000, 'ten more steps')
    assert (track.shepherds(track.last) != track.shepherds(first)).any(dim=-1).all()
    status = graph.until_status('flock_sim: commands', 'every shepherd answers')
    values = {value.key: value.value for value in status.values}
    assert (values['not_finite'], values['wrong_frame']) == ('0', '0')


@pytest.mark.parametrize('mode', ['lockstep', 'realtime'])
def test_plain_twists_drive_the_world_if_both_sides_say_so(graph: Graph, mode: str) -> None:
    track = graph.track()
    parameters = SMALL | {'mode': mode, 'rate': 20.0, 'stamped': False}
    sim = graph.host('flock_sim', **parameters)
    graph.host('strombom', stamped=False)
    graph.until(lambda: len(track.stamps) > 10, 'ten steps')
    names = dict(graph.node.get_topic_names_and_types())
    for h in range(2):
        assert names[f'/shepherd_{h}/cmd_vel'] == ['geometry_msgs/msg/Twist']
    first, last = (track.shepherds(track.stamps[k]) for k in (0, -1))
    assert (first != last).any(dim=-1).all()
    assert not sim.flock_commands.counts


def test_a_plain_twist_of_anybody_is_taken_for_the_present_state(graph: Graph) -> None:
    track = graph.track()
    graph.host('flock_sim', mode='lockstep', n_sheep=5, n_shepherds=1, stamped=False)
    publisher = graph.publisher('shepherd_0/cmd_vel', Twist)
    graph.until(lambda: track.stamps, 'the first state')
    command = Twist()
    command.linear.x = 1.0
    publisher.publish(command)
    graph.until(lambda: len(track.stamps) == 2, 'one step')
    direction = track.shepherds(track.stamps[1]) - track.shepherds(track.stamps[0])
    assert torch.allclose(direction, torch.tensor([[0.5, 0.0]]), atol=1e-5)
