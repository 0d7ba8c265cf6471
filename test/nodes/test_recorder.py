"""The recorder in this process: times, offers, latched messages, hidden topics and services."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from nodes.process import Graph, LATCHED, RELIABLE
import pytest
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.qos import LivelinessPolicy, QoSProfile
from rclpy.service_introspection import ServiceIntrospectionState
from rosbag2.tiny import cdr, make
from rosgraph_msgs.msg import Clock
from shepherd_ros.nodes.recorder_node import Recorder
from shepherd_ros.nodes.recorder_options import RecorderOptions
from shepherd_ros.recordings.info import bag_info
from shepherd_ros.rosbag2.diff import Decoder
from shepherd_ros.rosbag2.qos import Qos
from shepherd_ros.rosbag2.reader import open_bag
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool

SECOND = 10**9


@contextmanager
def recording(graph: Graph, folder: Path, **options: Any) -> Iterator[Recorder]:
    """Lend a recorder whose messages are taken by hand."""
    recorder = Recorder(RecorderOptions(str(folder), **options), context=graph.context)
    try:
        yield recorder
    finally:
        recorder.destroy_node()


def heard_publisher(
    graph: Graph, recorder: Recorder, topic: str, kind: Any, qos: QoSProfile = RELIABLE
) -> Publisher:
    """Return a publisher that the recorder listens to."""
    output = graph.node.create_publisher(kind, topic, qos)
    until_heard(graph, recorder, topic)
    graph.until(output.get_subscription_count, f'a reader of {topic}')
    return output


def until_heard(graph: Graph, recorder: Recorder, topic: str) -> None:
    """Look for topics until the recorder listens to one."""

    def listens() -> bool:
        recorder.subscribed.look()
        return topic in recorder.subscribed.inputs and bool(
            recorder.subscribed.inputs[topic].offers
        )

    graph.until(listens, f'a recorder of {topic}')


def until_received(graph: Graph, recorder: Recorder, count: int) -> None:
    """Take messages until there are as many."""
    seen = 0
    receive = recorder.receive

    def counting(*row: Any) -> None:
        nonlocal seen
        seen += 1
        receive(*row)

    def present() -> bool:
        recorder.poll_messages(everything=True)
        return seen >= count

    recorder.receive = counting  # type: ignore[method-assign]
    graph.until(present, lambda: f'{count} messages, got {seen}')
    recorder.receive = receive  # type: ignore[method-assign]


def test_what_comes_before_the_simulated_clock_has_its_first_time(
    graph: Graph, tmp_path: Path
) -> None:
    options = {'topics': ('/n', '/latched'), 'use_sim_time': True}
    with recording(graph, tmp_path / 'bag', **options) as recorder:
        outputs = [
            heard_publisher(graph, recorder, '/latched', String, LATCHED),
            heard_publisher(graph, recorder, '/n', Float64),
        ]
        clock = heard_publisher(graph, recorder, '/clock', Clock)
        outputs[0].publish(String(data='map'))
        outputs[1].publish(Float64(data=1.0))
        until_received(graph, recorder, 2)
        assert not (tmp_path / 'bag').exists()
        clock.publish(cdr(make('Clock', clock=make('Time', sec=5, nanosec=0))))
        until_received(graph, recorder, 1)
        outputs[1].publish(Float64(data=2.0))
        until_received(graph, recorder, 1)
        assert recorder.end() == 0
    sent = [(m.topic, m.log_ns) for m in open_bag(tmp_path / 'bag').messages()]
    assert sorted(sent) == [('/latched', 5 * SECOND)] + [('/n', 5 * SECOND)] * 2


def test_no_clock_is_told(
    graph: Graph, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = {'topics': ('/n',), 'use_sim_time': True}
    with recording(graph, tmp_path / 'bag', **options) as recorder:
        output = heard_publisher(graph, recorder, '/n', Float64)
        output.publish(Float64(data=1.0))
        until_received(graph, recorder, 1)
        assert recorder.end() == 1
    printed = capsys.readouterr().out
    assert '1 messages came and no /clock, which --use-sim-time needs' in printed
    assert 'the bag is NOT whole' in printed


@pytest.mark.parametrize('verbose', [False, True])
def test_the_end_is_five_lines_and_names_every_topic_if_asked(
    verbose: bool, graph: Graph, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    topics = ('/a', '/b', '/c')
    with recording(graph, tmp_path / 'bag', topics=topics, verbose=verbose) as recorder:
        for k, name in enumerate(topics, start=1):
            for number in (5, 6 + k):  # 4 came too early, k between the two are lost
                info = {'publication_sequence_number': number}
                info |= {'received_timestamp': number, 'source_timestamp': number}
                heard_once(graph, recorder, name)
                recorder.receive(name, cdr(make('Float64', data=1.0)), info)
        assert recorder.end() == 1
    first, *lines, last = capsys.readouterr().out.splitlines()
    assert first == f'6 messages of 3 topics in {tmp_path / "bag"}'
    assert last == 'the bag is NOT whole'
    early = 'sent before the first that was heard'
    if verbose:
        rows = [f'lost: /{n}: {k} missing in the numbering' for k, n in enumerate('abc', start=1)]
        assert [line.partition(',')[0] for line in lines[:3]] == rows
        assert lines[3:] == [f'{early}: /{name}: 4' for name in 'abc']
    else:
        most = 'of 3 topics, {} of them of {}; --verbose lists them'
        assert lines == [
            'lost: 6 messages ' + most.format(3, '/c'),
            f'{early}: 12 messages ' + most.format(4, '/a'),
        ]


def heard_once(graph: Graph, recorder: Recorder, topic: str) -> None:
    """Let the recorder find a topic."""
    if topic not in recorder.subscribed.inputs:
        heard_publisher(graph, recorder, topic, Float64)


def test_what_is_offered_is_recorded_and_shown(graph: Graph, tmp_path: Path) -> None:
    offered = QoSProfile(
        depth=3, deadline=Duration(seconds=0.5), lifespan=Duration(seconds=9),
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC, liveliness_lease_duration=Duration(seconds=2),
    )  # fmt: skip
    with recording(graph, tmp_path / 'bag', topics=('/n', '/plain')) as recorder:
        for topic, profile in (('/n', offered), ('/plain', RELIABLE)):
            output = heard_publisher(graph, recorder, topic, Float64, profile)
            output.publish(Float64(data=1.0))
            until_received(graph, recorder, 1)
        assert recorder.end() == 0
    bag = open_bag(tmp_path / 'bag')
    assert bag.topics['/plain'].qos == (Qos(),)
    assert bag.topics['/n'].qos == (
        Qos(
            deadline=(0, SECOND // 2), lifespan=(9, 0), liveliness='manual_by_topic',
            liveliness_lease_duration=(2, 0),
        ),
    )  # fmt: skip
    text = bag_info(bag).text()
    shown = 'deadline 0.5 s, lifespan 9 s, liveliness manual_by_topic, lease 2 s'
    assert f'Type: std_msgs/msg/Float64 | Count: 1 | Serialization Format: cdr | {shown}' in text
    assert text.count('deadline') == 1


def test_a_start_after_a_pause_keeps_the_last_of_every_latched_publisher(
    graph: Graph, tmp_path: Path
) -> None:
    with recording(graph, tmp_path / 'bag', topics=('/map', '/n'), start_paused=True) as recorder:
        outputs = [heard_publisher(graph, recorder, '/map', String, LATCHED) for _ in range(2)]
        trigger = heard_publisher(graph, recorder, '/n', Float64)
        for k, text in enumerate(('a', 'b', 'c', 'd')):
            outputs[bool(k)].publish(String(data=text))  # the first is silent then
            until_received(graph, recorder, 1)
        recorder.recording = True
        trigger.publish(Float64(data=1.0))
        until_received(graph, recorder, 1)
        assert recorder.end() == 0
    rows = open_bag(tmp_path / 'bag').messages(['/map'])
    assert [m.data.rstrip(b'\0')[8:] for m in rows] == [b'a', b'd']


def test_events_of_services_are_recorded_on_request(graph: Graph, tmp_path: Path) -> None:
    def answer(request: Any, response: Any) -> Any:
        response.success = request.data
        return response

    service = graph.node.create_service(SetBool, '/gate', answer)
    events = '/gate/_service_event'
    service.configure_introspection(
        graph.node.get_clock(), RELIABLE, ServiceIntrospectionState.CONTENTS
    )
    with recording(graph, tmp_path / 'bag', services=('/gate',)) as recorder:
        until_heard(graph, recorder, events)
        assert graph.call('/gate', SetBool, SetBool.Request(data=True)).success
        until_received(graph, recorder, 2)
        assert recorder.end() == 0
    bag = open_bag(tmp_path / 'bag')
    assert {name: (t.type, t.count) for name, t in bag.topics.items()} == {
        events: ('std_srvs/srv/SetBool_Event', 2)
    }
    decoder = Decoder(bag)
    assert decoder.can_decode('std_srvs/srv/SetBool_Event')
    first, last = (decoder.decode(message) for message in bag.messages())
    assert [bool(row.data) for row in first.request] == [True]
    assert [bool(row.success) for row in last.response] == [True]


def test_hidden_topics_and_services_are_asked_for_as_in_rosbag2() -> None:
    def chosen(**options: Any) -> list[str]:
        wanted: Callable[[str], bool] = RecorderOptions(**options).topic_filter(
            lambda name: f'/{name}'
        )
        names = ('/a', '/_h', '/b/_h/c', '/s/_service_event', '/clock')
        return [name for name in names if wanted(name)]

    assert chosen() == ['/clock']
    assert chosen(all=True) == ['/a', '/s/_service_event', '/clock']
    everything = ['/a', '/_h', '/b/_h/c', '/s/_service_event', '/clock']
    assert chosen(all=True, include_hidden_topics=True) == everything
    assert chosen(regex='_h') == []
    assert chosen(regex='_h', include_hidden_topics=True) == ['/_h', '/b/_h/c']
    assert chosen(topics=('_h',), include_hidden_topics=True) == ['/_h']
    assert chosen(services=('s',)) == chosen(all_services=True) == ['/s/_service_event']
    assert chosen(regex='^/s$') == ['/s/_service_event']
