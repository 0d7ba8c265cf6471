"""The node mux between its sources and flock_sim, over DDS."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
import json
from pathlib import Path
from threading import Thread
import time
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
import jsonschema
from nodes.process import DEADLINE, Graph, LATCHED, twist
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from shepherd_ros.bringup import herding_stack, Process, with_mux
from shepherd_ros.cli import main
from shepherd_ros.config import ConfigError
from shepherd_ros.nodes import world_client
from shepherd_ros.nodes.compose import compose
from shepherd_ros.resources import share_file
from shepherd_ros.ros.node import ERROR, OK, ShepherdNode
from shepherd_ros.ros.runtime import spin
from shepherd_ros.wire.decode import decode_twist_stamped, Poses, Vector
from shepherd_ros.wire.drivers import Drivers
from shepherd_ros.wire.encode import encode_text
from shepherd_ros.wire.topics import (
    COMMANDS,
    DRIVERS,
    SELECT,
    SHEPHERD_POSES,
    source_topic,
)
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool

STEPS = 330
SMALL: dict[str, Any] = {'n_sheep': 5, 'n_shepherds': 2}
SLOW = SMALL | {'mode': 'realtime', 'rate': 20.0}


# --- switches -----------------------------------------------------------------------------------


class Switcher(ShepherdNode):
    """Selects another source for one shepherd at each state, and keeps all commands."""

    backlog = 10_000

    def __init__(self, names: list[str], **kwargs: Any) -> None:
        """Listen to the sources, to what mux publishes and to states."""
        super().__init__('switcher', cli_args=[], **kwargs)
        self.names, self.states = names, Counter[int]()
        self.drivers: dict[int, Drivers] = {}  # by step
        self.published: dict[tuple[int, int], list[Vector]] = defaultdict(list)
        self.commanded: dict[tuple[str, int, int], Vector] = {}
        self.output = self.advertise(SELECT)
        self.listen(DRIVERS, self.on_drivers)
        for h in range(2):
            self.listen(COMMANDS, partial(self.on_command, h), h, decode=decode_twist_stamped)
            for name in names:
                self.listen(source_topic(name), partial(self.on_source, name, h), h)
        self.listen(SHEPHERD_POSES, self.on_state)

    def on_state(self, poses: Poses) -> None:
        """Select the other source for both shepherds in turn."""
        self.states[poses.stamp_ns] += 1
        k = len(self.states)
        h, name = k % 2, self.names[k // 2 % 2]
        self.output.publish(encode_text(f'{h} {name}'))

    def on_drivers(self, text: str) -> None:
        """Keep who drives."""
        drivers = Drivers.from_json(text)
        self.drivers[drivers.step] = drivers

    def on_command(self, shepherd: int, command: Vector) -> None:
        """Keep a command of mux."""
        self.published[shepherd, command.stamp_ns or 0].append(command)

    def on_source(self, name: str, shepherd: int, command: Vector) -> None:
        """Keep a command of a source."""
        self.commanded[name, shepherd, command.stamp_ns or 0] = command


def test_hundreds_of_switches_in_one_episode_lose_and_double_no_command(graph: Graph) -> None:
    stack = herding_stack('random', 2, n_sheep=2, episode_steps=STEPS, episodes=1)
    stack = [p for p in stack if p.executable not in ('lidar', 'metrics')]
    stack = with_mux(stack, [Process('pierson', 'pierson')])
    stack[0].parameters['wait_for_scans'] = False
    nodes = compose(stack, context=graph.context)
    sim: Any = nodes[0]
    switcher = Switcher(['random', 'pierson'], context=graph.context, transport=sim.transport)
    end = time.monotonic() + 2 * DEADLINE
    try:
        spin(
            [*nodes, switcher],  # latched messages do not go through the transport, and come later
            until=lambda: (
                (sim.finished and len(switcher.drivers) > STEPS) or time.monotonic() > end
            ),
        )
    finally:
        for node in [*nodes, switcher]:
            node.destroy_node()
    assert sim.finished
    stamps = sorted(switcher.states)
    assert len(stamps) == len(switcher.drivers) == STEPS + 1
    assert {b - a for a, b in pairwise(stamps)} == {sim.dt_ns}
    switches = 0
    for step, ns in enumerate(stamps):
        messages = switcher.drivers[step]
        assert (messages.step, messages.stamp, messages.episode) == (step, ns, 0)
        for h, driver in enumerate(messages.drivers):
            (command, *again) = switcher.published[h, ns]
            assert len(again) < switcher.states[ns]  # as often as the state was shown, at most
            assert set(again) <= {command}
            assert command == switcher.commanded[driver or '', h, ns]
            switches += step > 0 and driver != switcher.drivers[step - 1].drivers[h]
    assert switches >= 300
    assert not sim.flock_commands.counts - Counter(late=sum(switcher.states.values()))


# --- who drives ---------------------------------------------------------------------------------


@contextmanager
def published(graph: Graph, topic: str) -> Iterator[list[tuple[float, float]]]:
    """Give the list into which the commands of a topic come."""
    received: list[tuple[float, float]] = []
    subscription = graph.node.create_subscription(
        TwistStamped, topic, lambda m: received.append((m.twist.linear.x, m.twist.linear.y)), 100
    )
    try:
        yield received
    finally:
        graph.node.destroy_subscription(subscription)


def drivers(graph: Graph) -> list[Drivers]:
    """Return the list into which the drivers come, of both shepherds."""
    messages: list[Drivers] = []
    graph.node.create_subscription(
        String,
        'drivers',
        lambda message: messages.append(Drivers.from_json(message.data)),
        LATCHED,
    )
    return messages


def until_driven(graph: Graph, messages: list[Drivers], *names: str | None) -> None:
    """Spin until these drive."""
    graph.until(
        lambda: messages and messages[-1].drivers == names,
        lambda: f'{names} drive; last {messages[-1:]}',
    )


def test_in_lockstep_who_is_selected_drives_and_the_episode_goes_on(
    graph: Graph, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(world_client, 'DISCOVERY_TIMEOUT', DEADLINE)
    sim = graph.host('flock_sim', **SMALL)
    messages = drivers(graph)
    graph.host('mux', default='strombom')
    graph.idle(0.3)
    assert int(sim.state.step) == 0  # nothing drives before the default source
    graph.host('strombom', source='strombom')
    until_driven(graph, messages, 'strombom', 'strombom')
    schema = json.loads(share_file('msg_schemas', 'drivers.schema.json').read_text())
    jsonschema.validate(json.loads(messages[-1].to_json()), schema)
    keys = graph.publisher('shepherd_1/cmd_vel/keys', TwistStamped)
    assert messages[0].step == 0
    assert [b.step - a.step for a, b in pairwise(messages)] == [1] * (len(messages) - 1)

    def press() -> bool:
        keys.publish(twist(0, 0.3, 0.0, 'base_link'))
        return messages[-1].drivers == ('strombom', 'keys')

    graph.until(press, 'keys take shepherd_1 by their priority')
    until_driven(graph, messages, 'strombom', 'strombom')  # and let it go when they are silent

    def requested(*words: str, code: int = 0) -> str:
        codes: list[int] = []
        thread = Thread(target=lambda: codes.append(main([*words])))
        thread.start()
        graph.until(lambda: not thread.is_alive(), ' '.join(words))
        printed = capsys.readouterr()
        assert codes == [code], printed
        return printed.out + printed.err

    assert requested('drive', 'keys', '--shepherd', '0') == 'keys is selected for shepherd_0\n'
    until_driven(graph, messages, None, 'strombom')  # which are silent: zero, at once
    assert messages[-1].selected == ('keys', 'auto')
    before = sim.state.shepherds[0].clone()
    now = sim.now_ns
    graph.until(lambda: sim.now_ns > now + 3 * sim.dt_ns, 'the episode goes on')
    assert sim.state.shepherds[0].equal(before)
    assert requested('lock') == 'all shepherds: locked\n'
    until_driven(graph, messages, None, None)
    assert messages[-1].locked == (True, True)
    assert requested('unlock', '--shepherd', '1') == 'shepherd_1: not locked\n'
    until_driven(graph, messages, None, 'strombom')
    assert requested('unlock') == 'all shepherds: not locked\n'
    select = graph.publisher('mux/select', String)
    graph.listen_to_logs()
    for text, pattern in (
        ('keyes', "source is 'keyes'.*did you mean 'keys'"),
        ('7 keys', 'shepherd is 7: expected one of the 2 of the episode'),
        ('0 1 keys', "mux/select is '0 1 keys': expected a source or auto"),
    ):
        select.publish(String(data=text))
        graph.until(lambda pattern=pattern: graph.warnings(pattern), pattern)
    select.publish(String(data='auto'))
    until_driven(graph, messages, 'strombom', 'strombom')
    assert "did you mean 'keys'" in requested('drive', 'kexs', code=2)
    monkeypatch.setattr(world_client, 'DISCOVERY_TIMEOUT', 0.5)
    assert 'no /shepherd_5/mux/keys was found' in requested(
        'drive', 'keys', '--shepherd', '5', code=2
    )
    status = graph.until_status('mux: drivers', 'every shepherd has a driver')
    assert {v.key: v.value for v in status.values} == {
        'shepherd_0': 'strombom (selected: auto)', 'shepherd_1': 'strombom (selected: auto)'
    }  # fmt: skip


def test_a_lock_of_a_paused_world_takes_back_what_was_commanded(graph: Graph) -> None:
    sim = graph.host('flock_sim', **SMALL)
    messages = drivers(graph)
    graph.host('mux', default='strombom')
    graph.host('strombom', source='strombom')
    until_driven(graph, messages, 'strombom', 'strombom')
    assert graph.call('flock_sim/pause', SetBool, SetBool.Request(data=True)).success
    graph.until(lambda: sim.flock_commands.complete, 'the answers to the state that stands')
    assert any(any(v) for v in sim.flock_commands.commands.velocities)
    assert graph.call('mux/lock', SetBool, SetBool.Request(data=True)).success
    zero = [(0.0, 0.0)] * 2
    graph.until(lambda: sim.flock_commands.commands.velocities == zero, 'zero for this state')
    until_driven(graph, messages, None, None)
    assert messages[-1].stamp == sim.now_ns


def test_locked_or_silent_zero_is_published_at_once(graph: Graph) -> None:
    sim = graph.host('flock_sim', **SLOW)
    # so long a time-out that zero cannot come from it
    words = {'topics.keys.frame': 'world', 'topics.keys.timeout': 3 * DEADLINE}
    graph.host('mux', default='strombom', **words, **{'locks.stop.priority': 95})
    keys = graph.publisher('shepherd_0/cmd_vel/keys', TwistStamped)
    stop = graph.publisher('mux/locks/stop', Bool)
    messages = drivers(graph)
    with published(graph, 'shepherd_0/cmd_vel') as commands:
        keys.publish(twist(0, 0.25, -0.5))
        graph.until(lambda: (0.25, -0.5) in commands, 'keys drive')
        assert graph.call('shepherd_0/mux/lock', SetBool, SetBool.Request(data=True)).success
        graph.until(lambda: commands[-1] == (0.0, 0.0), 'zero')
        assert graph.call('shepherd_0/mux/lock', SetBool, SetBool.Request(data=False)).success
        graph.until(lambda: commands[-1] == (0.25, -0.5), 'keys drive')
        stop.publish(Bool(data=True))
        graph.until(lambda: commands[-1] == (0.0, 0.0), 'zero by the lock')
        graph.until(lambda: messages[-1].locked == (False, False), 'the lock of all is another')
        stop.publish(Bool(data=False))
        graph.until(lambda: commands[-1] == (0.25, -0.5), 'keys drive')
        graph.trigger('shepherd_0/mux/strombom')
        graph.until(lambda: commands[-1] == (0.0, 0.0), 'zero, as strombom has never been heard')
        until_driven(graph, messages, None, None)
        graph.until(lambda: sim.flock_commands.commands.velocities[0] == (0.0, 0.0), 'it stands')


def test_two_sources_work_together_and_a_source_may_send_twist(graph: Graph) -> None:
    graph.host('flock_sim', **SLOW)
    messages = drivers(graph)
    mux = graph.start('mux')
    until_driven(graph, messages, None, None)
    other = Context()  # a process has one type for each topic
    rclpy.init(args=[], context=other, domain_id=graph.domain)
    teleop = Node('teleop_twist_keyboard', context=other)
    plain = teleop.create_publisher(Twist, 'shepherd_1/cmd_vel/keys', 10)
    joy = graph.publisher('shepherd_1/cmd_vel/joy', TwistStamped)
    forward = Twist()
    forward.linear.x = 0.5
    try:

        def steer(*outputs: Any) -> bool:
            if plain in outputs:
                plain.publish(forward)
            if joy in outputs:
                joy.publish(twist(0, 0.1, 0.0, ''))
            name = 'joy' if joy in outputs else 'keys'
            return bool(messages) and messages[-1].drivers == (None, name)

        graph.until(lambda: steer(plain), 'keys drive')
        graph.until(lambda: steer(plain, joy), 'joy has precedence')
        graph.until(lambda: steer(plain), 'keys drive again once joy is silent')
    finally:
        teleop.destroy_node()
        other.try_shutdown()
    until_driven(graph, messages, None, None)
    assert mux.stop() == 0, mux


def test_a_world_without_stamps_is_driven_and_another_type_is_named(graph: Graph) -> None:
    sim = graph.start('flock_sim', stamped=False, **SMALL)
    messages = drivers(graph)
    mux = graph.host('mux', default='strombom', stamped=False)
    graph.start('strombom', source='strombom', stamped=False)
    until_driven(graph, messages, 'strombom', 'strombom')
    graph.until(lambda: messages[-1].step > 3, 'steps')
    assert mux.diagnose()[0].level == OK
    assert len(mux.diagnose()) == 1
    graph.end(mux)
    mux = graph.start('mux', default='strombom')
    printed = graph.until_says(
        mux, 'shepherd_0/cmd_vel is geometry_msgs/msg/TwistStamped, but (.*)'
    )
    assert 'flock_sim hears geometry_msgs/msg/Twist: expected one type' in printed[1]
    pattern = 'of another type than geometry_msgs/msg/Twist: shepherd_0/cmd_vel as .*Stamped'
    assert graph.until_status('flock_sim: commands', pattern).level == ERROR
    assert sim.stop() == 0, sim


def test_one_process_has_one_type_of_commands(graph: Graph) -> None:
    graph.host('flock_sim', stamped=False, **SMALL)
    messages = drivers(graph)
    graph.host('mux', default='idle', stamped=False)
    own = graph.host('idle', source='idle', stamped=False)
    until_driven(graph, messages, 'idle', 'idle')
    graph.until(lambda: messages[-1].step > 3, 'steps')
    graph.end(own)
    graph.host('strombom', source='idle')
    with pytest.raises(ConfigError, match=r'shepherd_0/cmd_vel/idle is .*TwistStamped for one'):
        graph.until(lambda: False, 'another type is refused')


def test_a_key_that_turns_a_shepherd_turns_where_forward_is(graph: Graph) -> None:
    sim = graph.host('flock_sim', **SMALL)
    graph.host('mux', default='strombom', **{'topics.keys.timeout': 30.0, 'start_timeout': 0.0})
    keys = graph.publisher('shepherd_0/cmd_vel/keys', TwistStamped)
    turn = twist(0, 0.0, 0.0)
    turn.twist.angular.z = 1.0
    graph.call('flock_sim/pause', SetBool, SetBool.Request(data=True))
    node = graph.hosted[-1]
    keys.publish(turn)
    graph.until(lambda: node.mux.states and node.mux.states[0]['keys'].velocity[2], 'a turn')
    graph.until(lambda: sim.flock_commands.complete, 'answers')
    before = node.frames.yaw[0]
    graph.steps(4)
    graph.until(lambda: sim.pacing.steps_left == 0 and sim.flock_commands.complete, 'four steps')
    assert 0 < node.frames.yaw[0] - before <= 4 * 0.5 + 1e-9


# --- what cannot be -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ('parameters', 'message'),
    [
        ({'topics.keys.priority': 0}, r'topics.keys.priority is 0: expected a value in \[1, 255'),
        ({'topics.keys.priority': 256}, r'topics.keys.priority is 256: expected a value in'),
        ({'topics.tablet.priority': 100}, 'topics.tablet.priority is 100, as that of joy'),
        ({'locks.stop.priority': 10}, 'locks.stop.priority is 10: expected more than 10'),
        ({'topics.keys.timeout': 0.0}, 'topics.keys.timeout is 0.0: expected a value in'),
        ({'topics.keys.frame': 'odom'}, "topics.keys.frame is 'odom': expected one of world, b"),
        ({'topics.keys.topic': 'a b'}, "topics.keys.topic is 'a b': expected the name of a topic"),
        ({'topics.auto.priority': 3}, "topics has 'auto': expected lower-case letters"),
        ({'topics.Tab.priority': 3}, "topics has 'Tab': expected lower-case letters"),
    ],
)
def test_parameters_that_cannot_be_are_refused_by_name(
    shared_graph: Graph, parameters: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        shared_graph.host('mux', **parameters)


FILE = """
/**/mux:
  ros__parameters:
    topics:
      navigation: {topic: nav_vel, timeout: 0.5, priority: 20}
    locks:
      pause: {topic: pause_navigation, timeout: 0.0, priority: 95}
"""


def test_a_user_of_twist_mux_brings_topics_of_any_name(graph: Graph, tmp_path: Path) -> None:
    graph.host('flock_sim', **SLOW)
    (tmp_path / 'mux.yaml').write_text(FILE)
    graph.host('mux', '--params-file', str(tmp_path / 'mux.yaml'))
    messages = drivers(graph)
    nav = graph.publisher('nav_vel', TwistStamped)

    def go() -> bool:
        nav.publish(twist(0, 0.5, 0.0))
        return bool(messages) and messages[-1].drivers == ('navigation', 'navigation')

    graph.until(go, 'one topic drives all shepherds')
    pause = graph.publisher('pause_navigation', Bool)
    pause.publish(Bool(data=True))
    until_driven(graph, messages, None, None)
