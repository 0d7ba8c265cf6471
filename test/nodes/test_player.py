"""The player on bags of others, in this process: what it skips, and what it offers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
import re
import time
from typing import Any

from nodes.process import DEADLINE, Graph, LATCHED, RELIABLE
import pytest
from rclpy.qos import LivelinessPolicy
from rosbag2.tiny import cdr, make, STORE
from rosbags.rosbag2 import Writer
from shepherd_ros.config import ConfigError
from shepherd_ros.nodes.player_node import MIN_LOOP_PERIOD, Player
from shepherd_ros.nodes.player_options import PlayerOptions
from shepherd_ros.rosbag2.qos import Qos
from shepherd_ros.rosbag2.writer import BagWriter
from std_msgs.msg import String

TEXT, FLOAT = 'std_msgs/msg/String', 'std_msgs/msg/Float64'
STRING = ('ros2msg', b'string data\n')
TWICE = Qos(durability='transient_local')
SECOND = 10**9


@contextmanager
def playing(graph: Graph, folder: Path, **options: Any) -> Iterator[Player]:
    """Lend a player that plays, and end it."""
    player = Player(PlayerOptions(folder, **options), context=graph.context)
    try:
        yield player
    finally:
        player.stopped.set()
        player.wake.set()
        player.thread.join(DEADLINE)
        player.destroy_node()


def bag_of(
    folder: Path, rows: dict[str, list[tuple[int, str]]], qos: tuple[Qos, ...] = (Qos(),)
) -> Path:
    """Write texts with their log times [ns], by topic."""
    with BagWriter(folder) as writer:
        for topic, messages in rows.items():
            writer.add_topic(topic, TEXT, qos, schema=STRING)
            for ns, text in messages:
                writer.write(topic, cdr(make('String', data=text)), SECOND + ns, SECOND + ns)
    return folder


def test_what_cannot_be_played_is_skipped_and_the_rest_is_played(
    shared_graph: Graph, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/x', TEXT, [Qos()], schema=STRING)
        writer.add_topic('/y', 'wool_msgs/msg/Sheep', schema=STRING)
        writer.add_topic('/events/write_split', 'rosbag2_interfaces/msg/W', schema=STRING)
        writer.add_topic('/a//b', TEXT, schema=STRING)
        writer.add_topic('/j', TEXT, schema=STRING, serialization='json')
        writer.add_topic('/f', FLOAT, schema=('ros2msg', b'float32 a\nfloat32 data\n'))
        # another text that means the same
        writer.add_topic('/s', TEXT, schema=('ros2msg', b'# a word\nstring   data  # it\n'))
        for topic in ('/x', '/y', '/j', '/f', '/s'):
            writer.write(topic, cdr(make('String', data=topic)), SECOND, SECOND)
    received = [shared_graph.collect(name, String, RELIABLE) for name in ('/s', '/x')]
    with playing(shared_graph, tmp_path / 'bag', wait=DEADLINE) as player:
        assert player.names == ['/s', '/x']
        shared_graph.until(lambda: all(received), 'what can be played')
    output = capfd.readouterr().err
    for what in (
        "/y has the type 'wool_msgs/msg/Sheep', which is not installed",
        "/events/write_split has the type 'rosbag2_interfaces/msg/W'",
        "'/a//b' is no name of a topic",
        "/j is in 'json', expected cdr",
        "/f was recorded with another 'std_msgs/msg/Float64' than the",
    ):
        assert what in output
    with pytest.raises(ConfigError, match='/f was recorded with another'):
        Player(PlayerOptions(tmp_path / 'bag', topics=('/f',)), context=shared_graph.context)


def test_the_clock_goes_on_between_messages_and_stands_in_a_pause(
    shared_graph: Graph, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bag = bag_of(tmp_path / 'bag', {'/x': [(0, 'a'), (900 * SECOND, 'b')]})
    with playing(shared_graph, bag, clock=50.0) as player:
        shared_graph.until(lambda: player.played == 1, 'the first message')
        player.report_progress()
        assert re.search(r'\d of 900 s, 1 messages', ''.join(capfd.readouterr()))
        shared_graph.until(lambda: player.bag_time() > SECOND, 'the clock goes on')
        early, begun, late = time.monotonic(), player.bag_time(), time.monotonic()
        shared_graph.idle(0.1)
        least, passed, most = time.monotonic(), player.bag_time() - begun, time.monotonic()
        assert least - late < passed / SECOND + 1e-6 < most - early + 2e-6
        player.running.clear()
        player.wake.set()
        shared_graph.until(lambda: player.paused, 'the pause')
        still = player.bag_time()
        shared_graph.idle(0.2)
        assert player.bag_time() == still < 901 * SECOND


@pytest.mark.parametrize('qos', [(TWICE, TWICE), (Qos(durability='transient_local', depth=9),)])
def test_a_late_reader_gets_what_is_latched_of_every_publisher(
    shared_graph: Graph, tmp_path: Path, qos: tuple[Qos, ...]
) -> None:
    bag = bag_of(tmp_path / 'bag', {'/tf_like': [(0, 'A'), (9, 'B'), (60 * SECOND, 'C')]}, qos)
    with playing(shared_graph, bag, start_offset=2.0) as player:
        shared_graph.until(lambda: player.played == 2, 'what is latched')
        received = shared_graph.collect('/tf_like', String, LATCHED)
        shared_graph.until(lambda: len(received) == 2, 'both')
        assert [message.data for message in received] == ['A', 'B']


def test_a_bag_in_sqlite_is_played(shared_graph: Graph, tmp_path: Path) -> None:
    with Writer(tmp_path / 'bag', version=9) as writer:
        connection = writer.add_connection('/lite', TEXT, typestore=STORE)
        writer.write(connection, SECOND, cdr(make('String', data='lite')))
    received = shared_graph.collect('/lite', String, RELIABLE)
    with playing(shared_graph, tmp_path / 'bag', wait=DEADLINE):
        shared_graph.until(lambda: received, 'the message')
    assert received[0].data == 'lite'


def test_one_message_again_and_again_is_no_flood(shared_graph: Graph, tmp_path: Path) -> None:
    bag = bag_of(tmp_path / 'bag', {'/x': [(0, 'a')]})
    with playing(shared_graph, bag, loop=True) as player:
        shared_graph.until(lambda: player.played > 2, 'three rounds')
        before, begun = player.played, time.monotonic()
        shared_graph.idle(0.5)
        assert player.played - before <= (time.monotonic() - begun) / MIN_LOOP_PERIOD + 1


def test_what_was_offered_is_offered_again(shared_graph: Graph, tmp_path: Path) -> None:
    qos = Qos(
        deadline=(0, 300_000_000), lifespan=(5, 1), liveliness='manual_by_topic',
        liveliness_lease_duration=(2, 0),
    )  # fmt: skip
    bag = bag_of(tmp_path / 'bag', {'/offered': [(0, 'a')]}, (qos, qos))
    with playing(shared_graph, bag, start_paused=True) as player:
        (info,) = player.get_publishers_info_by_topic('/offered')
        offer = info.qos_profile
        assert offer.deadline.nanoseconds == 300_000_000
        assert offer.lifespan.nanoseconds == 5_000_000_001
        assert offer.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC
        assert offer.liveliness_lease_duration.nanoseconds == 2_000_000_000
