"""The transport between nodes of one process: nobody misses a message, nobody hears one twice."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import time
from typing import Any

from geometry_msgs.msg import PoseArray
from nodes.process import assert_same_states, DEADLINE, Graph, rollout
import pytest
from shepherd_ros.bringup import herding_stack
from shepherd_ros.nodes.compose import compose
from shepherd_ros.ros.intra_process import IntraProcessTransport
from shepherd_ros.ros.node import EXECUTORS, ShepherdNode
from shepherd_ros.ros.runtime import spin
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.wire.encode import encode_poses
import torch

STEPS = 30
NOBODY = torch.zeros(1, 2).numpy()


@contextmanager
def alive(nodes: list[ShepherdNode]) -> Iterator[list[ShepherdNode]]:
    """Give nodes and destroy them."""
    try:
        yield nodes
    finally:
        for node in nodes:
            node.destroy_node()


def run(nodes: list[ShepherdNode], done: Callable[[], bool], graph: Graph | None = None) -> None:
    """Spin nodes, and the probe beside them, until something is so."""
    end = time.monotonic() + DEADLINE

    def until() -> bool:
        if graph is not None:
            graph.executor.spin_once(timeout_sec=0)
        assert time.monotonic() < end, 'not in time'
        return done()

    spin(nodes, until=until)


def stack(graph: Graph, executor: str = 'events', **options: Any) -> list[ShepherdNode]:
    """Return a composed stack of two shepherds that waits for all scans."""
    options = {'n_sheep': 10, 'episode_steps': STEPS, 'wait_for_scans': True} | options
    return compose(
        herding_stack('pierson', n_shepherds=2, executor=executor, **options),
        context=graph.context,
    )


class Talk(ShepherdNode):
    """A node that says and hears the poses of the flock."""

    def __init__(self, graph: Graph, name: str, transport: IntraProcessTransport | None) -> None:
        """Hear poses; what they say is their stamp."""
        super().__init__(name, transport=transport, context=graph.context, cli_args=[])
        self.out = self.advertise('flock/poses')
        self.received: list[int] = []
        self.reader = self.listen('flock/poses', self.on_poses, decode=bytes)

    def on_poses(self, raw: bytes) -> None:
        """Keep the stamp."""
        self.received.append(int.from_bytes(raw[8:12], 'little'))

    def say(self, number: int) -> None:
        """Publish poses with a stamp."""
        self.out.publish(encode_poses(number, 'map', NOBODY, NOBODY))


@pytest.mark.parametrize('executor', EXECUTORS)
def test_a_stack_on_the_bus_does_what_the_environment_does(graph: Graph, executor: str) -> None:
    with alive(stack(graph, executor, episodes=1)) as nodes:
        sim: Any = nodes[0]
        run(nodes, lambda: sim.finished)
        assert nodes[0].transport is not None
        # poses of two kinds, and of each shepherd three scans and a command
        assert nodes[0].transport.delivered >= 0.5 * STEPS * (2 + 2 * 4)
        world = WorldConfig(n_sheep=10, n_shepherds=2, episode_steps=STEPS)
        expected = rollout('pierson', EnvConfig(world=world))[0][-1]
        assert torch.equal(sim.state.sheep, expected.sheep)
        assert torch.equal(sim.state.shepherds, expected.shepherds)


def test_who_listens_from_elsewhere_hears_all_and_the_episode_is_the_same(graph: Graph) -> None:
    with alive(stack(graph, episodes=2)) as nodes:
        sim: Any = nodes[0]
        track = graph.track()
        for output in (sim.output.outputs[f'{side}/poses'] for side in track.halves):
            # two lidars, metrics, controller and the probe
            graph.until(lambda o=output: o.get_subscription_count() == 5, 'all are there')
        run(nodes, lambda: sim.finished and len(track.stamps) >= 2 * (STEPS + 1), graph)
        world = WorldConfig(n_sheep=10, n_shepherds=2, episode_steps=STEPS)
        assert_same_states(track, rollout('pierson', EnvConfig(world=world), episodes=2)[0])


def test_everybody_hears_each_message_once_whoever_comes_and_goes(graph: Graph) -> None:
    transport = IntraProcessTransport()
    with alive([Talk(graph, name, transport) for name in ('one', 'two')]) as nodes:
        one, two = nodes
        assert isinstance(one, Talk) and isinstance(two, Talk)
        number = 0

        def say(count: int, *others: list[Any]) -> None:
            nonlocal number
            sent = [number + k for k in range(count)]
            for k in sent:
                one.say(k)
            number += count
            run(nodes, lambda: len(two.received) >= number and len(one.received) >= number, graph)
            for messages in others:
                run(nodes, lambda messages=messages: len(messages) >= count, graph)
                assert [m.header.stamp.nanosec for m in messages[-count:]] == sent

        graph.until(lambda: one.out.get_subscription_count() == 2, 'both have found each other')
        graph.until(
            lambda: len(one.get_subscriptions_info_by_topic('flock/poses')) == 2, 'in the graph'
        )
        say(20)
        assert transport.delivered == 20
        probe = graph.collect('flock/poses', PoseArray)
        graph.until(lambda: one.out.get_subscription_count() == 3, 'the probe is there')
        say(20, probe)
        assert transport.delivered == 20, 'who is elsewhere hears by DDS, and so do all'
        assert len(probe) == 20
        graph.node.destroy_subscription(next(iter(graph.node.subscriptions)))
        graph.until(lambda: one.out.get_subscription_count() == 2, 'the probe is gone')
        graph.until(lambda: len(one.get_subscriptions_info_by_topic('flock/poses')) == 2, 'gone')
        say(20)
        assert transport.delivered == 40
        assert one.received == two.received == list(range(60))


def test_a_full_queue_drops_the_oldest_and_the_destroyed_hear_nothing(graph: Graph) -> None:
    transport = IntraProcessTransport()
    with alive([Talk(graph, name, transport) for name in ('one', 'two')]) as nodes:
        one, two = nodes
        assert isinstance(one, Talk) and isinstance(two, Talk)
        graph.until(lambda: one.out.get_subscription_count() == 2, 'both have found each other')
        graph.until(
            lambda: len(one.get_subscriptions_info_by_topic('flock/poses')) == 2, 'in the graph'
        )
        depth = one.reader.qos_profile.depth
        for number in range(depth + 7):  # nobody spins yet
            one.say(number)
        assert transport.delivered == depth + 7
        two.destroy_subscription(two.reader)
        run(nodes, lambda: len(one.received) >= depth)
        assert one.received == list(range(7, depth + 7))
        assert two.received == []


@pytest.mark.parametrize('executor', EXECUTORS)
def test_a_callback_on_the_bus_that_fails_ends_the_spin(graph: Graph, executor: str) -> None:
    transport = IntraProcessTransport()
    with alive([Talk(graph, 'one', transport)]) as (one,):
        assert isinstance(one, Talk)
        one.executor_kind = executor

        def fail(raw: bytes) -> None:
            raise ArithmeticError('of a callback')

        one.destroy_subscription(one.reader)
        one.listen('flock/poses', fail, decode=bytes)
        graph.until(lambda: one.out.get_subscription_count() == 1, 'it has found itself')
        graph.until(
            lambda: len(one.get_subscriptions_info_by_topic('flock/poses')) == 1, 'in the graph'
        )
        one.say(1)
        assert transport.delivered == 1
        with pytest.raises(ArithmeticError, match='of a callback'):
            run([one], lambda: False)


def test_herd_runs_a_stack_in_one_process_and_ends_by_itself(graph: Graph) -> None:
    track = graph.track('/far')
    words = ['--controller', 'pierson', '--sheep', '5', '--steps', '60', '--shepherds', '2']
    herd = graph.start_words('herd', [*words, '--episodes', '1', '--ros-args', '-r', '__ns:=/far'])
    assert herd.wait() == 0
    assert '1 episodes done' in herd.text
    world = WorldConfig(n_sheep=5, n_shepherds=2, episode_steps=60)
    states = rollout('pierson', EnvConfig(world=world))[0]
    end = int(len(states) * world.dt * 1e9)
    graph.until(lambda: track.last == end, 'the last state')
    first = len(states) - len(track.stamps)  # the probe may have come later than the start
    assert len(track.stamps) >= 1
    assert_same_states(track, states[first:])


@pytest.mark.parametrize(
    ('words', 'printed'),
    [
        (['--controller', 'sheepdog'], "'sheepdog': expected one of "),
        (['--shepherds', '0'], 'n_shepherds is 0: expected a value in'),
        (['--sheep', '0'], 'n_sheep is 0: expected a value in'),
    ],
)
def test_herd_names_what_is_wrong(graph: Graph, words: list[str], printed: str) -> None:
    herd = graph.start_words('herd', words)
    assert herd.wait() == 2
    assert printed in herd.text
    assert 'Traceback' not in herd.text
