"""Recorder and player as processes: nothing is lost, what is lost is told, and all comes back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
import json
from pathlib import Path
import re
import resource
from signal import SIGCONT, SIGHUP, SIGKILL, SIGSTOP
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseArray, PoseStamped, Twist
from mcap.exceptions import EndOfFile
from mcap.records import Message
from mcap.stream_reader import StreamReader
from nodes.process import BEST_EFFORT, Graph, LATCHED, Process, RELIABLE, rollout, until
import numpy as np
import pytest
from rclpy.parameter import Parameter
from rosbag2.tiny import (
    cdr,
    LOG_START_NS,
    make,
    pose,
    poses,
    recording,
    scan_of,
    Sent,
    tiny_bag,
    write,
)
from rosbag2.tiny import twist as tiny_twist
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from shepherd_ros import __version__
from shepherd_ros.cli import main
from shepherd_ros.recordings.check import check_bag
from shepherd_ros.recordings.episodes import iter_episodes
from shepherd_ros.recordings.recording_writer import (
    CONTRACT_KEY,
    EPISODE_KEY,
    LOST_KEY,
    VERSION_KEY,
)
from shepherd_ros.rosbag2.bag import Bag
from shepherd_ros.rosbag2.diff import diff_bags
from shepherd_ros.rosbag2.qos import Qos
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.rosbag2.writer import BagWriter
from shepherd_ros.sim.presets import world_preset
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.wire.contract import contract_hash
from shepherd_ros.wire.decode import decode_string
from std_msgs.msg import Float64, Int32, String
from std_srvs.srv import SetBool, Trigger

pytestmark = pytest.mark.system
EPISODES, STEPS = 2, 30
WORLD = {'n_sheep': 10, 'n_shepherds': 2, 'episode_steps': STEPS}
SENSED = [f'/shepherd_{h}/scan/{c}' for h in (0, 1) for c in ('sheep', 'shepherds', 'goal')]
ANSWERS = [f'/shepherd_{h}/cmd_vel' for h in (0, 1)]
STACK = ['/clock', '/episode', '/goal', '/flock/poses', '/shepherds/poses', *SENSED, *ANSWERS]
WHOLE = 'the bag is whole'


# ---- how to record and play ----


def start_recorder(graph: Graph, folder: Path, *words: str) -> Process:
    """Start a recorder and wait until it listens."""
    recorder = graph.start_words('recorder', ['-v', '-o', str(folder), *words])
    graph.until_says(recorder, 'listening')
    return recorder


def until_recorded(graph: Graph, recorder: Process, *topics: str) -> None:
    """Spin until the recorder listens to topics."""
    for topic in topics:
        graph.until_says(recorder, f'recording {topic} ')


def counts(graph: Graph) -> dict[str, str]:
    """Return what the recorder last said of itself on /diagnostics."""
    status = graph.status('recorder: recorder')
    return {value.key: value.value for value in status.values} if status else {}


def until_taken(graph: Graph, more_than: int) -> int:
    """Spin until the recorder has more messages than that and gets no more; return how many."""

    def quiet() -> int:
        printed = counts(graph)
        now = int(printed.get('messages', '0'))
        return now if now > more_than and printed['rate'] == '0.0' else 0

    what = f'a recorder that is done with more than {more_than} messages'
    return graph.until(quiet, lambda: f'{what}; it last said {counts(graph)}')


def until_heard_again(graph: Graph, send: Callable[[], None]) -> int:
    """
    Send until a recorder that was held up takes messages again; return how often was sent.

    What came while it was held up may be lost to the last.
    """
    before, sent = int(counts(graph)['messages']), 0

    def received() -> bool:
        nonlocal sent
        send()
        sent += 1
        graph.idle(0.3)
        return int(counts(graph)['messages']) > before

    graph.until(received, lambda: f'more messages; the recorder last said {counts(graph)}')
    return sent


def run_stack(graph: Graph, folder: Path, *words: str) -> Process:
    """Record two episodes from the first state on; return the recorder that was stopped."""
    recorder = start_recorder(graph, folder, '-x', '/diagnostics', *words)
    sim = graph.start('flock_sim', episodes=EPISODES, wait_for_scans=True, **WORLD)
    assert graph.call('/flock_sim/pause', SetBool, SetBool.Request(data=True)).success
    others = [graph.start('lidar', shepherd_ids=[0, 1]), graph.start('strombom')]
    until_recorded(graph, recorder, *STACK)
    shown = graph.collect('/shepherd_1/scan/goal', LaserScan)
    graph.until(lambda: len(shown) >= 2, 'a paused world shows its state')
    assert graph.call('/flock_sim/pause', SetBool, SetBool.Request(data=False)).success
    assert sim.wait() == 0, sim
    recorder.stop()
    for process in others:
        assert process.stop() == 0, process
    return recorder


@dataclass
class Run:
    """What was recorded of a whole run."""

    folder: Path
    recorder: Process

    @property
    def bag(self) -> Bag:
        """Return the bag."""
        return open_bag(self.folder)


@pytest.fixture(scope='module')
def whole(shared_graph: Graph, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Record one run for all tests."""
    folder = tmp_path_factory.mktemp('whole') / 'bag'
    return Run(folder, run_stack(shared_graph, folder))


@pytest.fixture
def room(graph: Graph) -> Graph:
    """
    Lend an empty graph of one's own.

    Not that of another test: what a node said of itself can be read after it has left, and then
    its name stays in the graph of whoever read it.
    """
    return graph


@contextmanager
def hearing(graph: Graph, topic: str, kind: Any, qos: Any = RELIABLE) -> Iterator[list[Any]]:
    """Give the list into which messages come as bytes."""
    received: list[Any] = []
    subscription = graph.node.create_subscription(kind, topic, received.append, qos, raw=True)
    try:
        yield received
    finally:
        graph.node.destroy_subscription(subscription)


def ask(graph: Graph, service: str) -> tuple[bool, str]:
    """Return what a service without arguments answers."""
    answer = graph.call(service, Trigger, Trigger.Request())
    return answer.success, answer.message


def pause(graph: Graph, on: bool) -> None:
    """Let the player pause or go on."""
    assert graph.call('/player/pause', SetBool, SetBool.Request(data=on)).success


def values(path: Path, n: int, gap_ns: int = 10_000_000, **options: Any) -> Path:
    """Write a bag of numbers on /metrics/flock_spread."""
    rows = [
        Sent(
            '/metrics/flock_spread', 'std_msgs/msg/Float64', cdr(make('Float64', data=float(k))),
            LOG_START_NS + k * gap_ns, LOG_START_NS + k * gap_ns,
        )
        for k in range(n)
    ]  # fmt: skip
    return write(path, rows, **options)


# ---- a whole run ----


def test_a_recorded_run_is_whole(whole: Run) -> None:
    assert whole.recorder.code == 0, whole.recorder
    assert WHOLE in whole.recorder.text
    assert f'{whole.bag.count} messages of {len(whole.bag.topics)} topics' in whole.recorder.text
    result = check_bag(whole.bag, ('scans', 'commands'))
    assert result.ok, result.text()
    assert (result.episodes, result.steps) == (EPISODES, EPISODES * (STEPS + 1))
    assert (result.absent, result.unfinished) == ([], [])
    assert set(whole.bag.topics) >= set(STACK)


def test_the_recorded_states_are_those_of_the_core(whole: Run) -> None:
    world = replace(world_preset('default', 'strombom'), **WORLD)
    states, _ = rollout('strombom', EnvConfig(world=world), episodes=EPISODES)
    frames = [frame for episode in iter_episodes(whole.bag) for frame in episode.frames]
    assert len(frames) == len(states)
    for frame, state in zip(frames, states, strict=True):
        present = state.shepherds[state.shepherd_mask]
        assert np.array_equal(frame.sheep.astype(np.float32), state.sheep.numpy())
        assert np.array_equal(frame.shepherds.astype(np.float32), present.numpy())


def test_rosbags_reads_the_same(whole: Run) -> None:
    with AnyReader([whole.folder]) as reader:
        reference = {name: info.msgcount for name, info in reader.topics.items()}
        assert reader.message_count == whole.bag.count
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
    assert reference == {name: topic.count for name, topic in whole.bag.topics.items()}


def test_what_is_played_and_recorded_again_is_equal(
    whole: Run, room: Graph, tmp_path: Path
) -> None:
    recorder = start_recorder(room, tmp_path / 'again', '-x', '/diagnostics')
    player = room.start_words('player', [str(whole.folder), '--rate', '20', '--wait', '10'])
    assert player.wait() == 0, player
    assert f'{whole.bag.count} messages of {len(whole.bag.topics)} topics; late by ' in player.text
    assert recorder.stop() == 0, recorder
    result = diff_bags(whole.bag, open_bag(tmp_path / 'again'))
    assert result.equal, result.text()
    offered = {name: topic.qos for name, topic in whole.bag.topics.items()}
    again = open_bag(tmp_path / 'again').topics
    for name, qos in offered.items():
        assert [(q.reliability, q.durability) for q in again[name].qos] == [
            (q.reliability, q.durability) for q in qos
        ]


def test_one_bag_per_episode(room: Graph, tmp_path: Path) -> None:
    recorder = run_stack(room, tmp_path / 'bags', '--per-episode')
    assert recorder.code == 0, recorder
    folders = sorted((tmp_path / 'bags').iterdir())
    assert [folder.name for folder in folders] == ['episode_0000', 'episode_0001']
    for folder in folders:
        result = check_bag(open_bag(folder), ('scans', 'commands'))
        assert result.ok, result.text()
        assert (result.episodes, result.steps) == (1, STEPS + 1)


def test_a_recorder_that_joins_a_run_at_full_speed_says_what_its_bag_holds(
    room: Graph, tmp_path: Path
) -> None:
    """Nothing before its first whole state is a loss; from there on its verdict is the bag's."""
    room.start('flock_sim', wait_for_scans=True, **(WORLD | {'episode_steps': 100_000}))
    room.start('lidar', shepherd_ids=[0, 1])
    room.start('strombom')
    track = room.track()
    room.until(lambda: len(track.stamps) > 20, 'a run')
    recorder = start_recorder(room, tmp_path / 'bag', '-x', '/diagnostics')
    until_recorded(room, recorder, *STACK)
    room.until(lambda: int(counts(room).get('messages', '0')) > 1000, 'a hundred steps')
    code = recorder.stop()
    result = check_bag(open_bag(tmp_path / 'bag'), ('scans', 'commands'))
    assert code == (not result.ok), f'{recorder}\n{result.text()}'
    assert re.search('sent before the first that was heard: /flock/poses: [0-9]+', recorder.text)
    (frames,) = (episode.frames for episode in iter_episodes(open_bag(tmp_path / 'bag')))
    begin = result.late[0]
    assert 20 <= frames[0].step <= begin < frames[-1].step
    assert all(f.step >= begin for f in result.findings if f.kind == 'gap')


# ---- the recorder ----


def flood(graph: Graph, publisher: Any, rows: list[bytes], rate: float) -> None:
    """Publish bytes at a rate [1/s]."""
    begun = time.monotonic()
    for k, row in enumerate(rows):
        while (ahead := begun + k / rate - time.monotonic()) > 0:
            time.sleep(ahead)
        publisher.publish(row)
    graph.spin()


def test_topics_are_selected_and_packed_and_split(room: Graph, tmp_path: Path) -> None:
    names = ['/a/one', '/a/two', '/b/three', '/flock/spread', '/a/three']
    recorder = start_recorder(
        room, tmp_path / 'bag', '--topics', '/flock/spread', '--regex', '^/a/', '--exclude', 'two',
        '--compression', 'zstd', '--max-bag-size', '20000',
    )  # fmt: skip
    outputs = [room.node.create_publisher(String, name, RELIABLE) for name in names]
    until_recorded(room, recorder, '/a/one', '/a/three', '/flock/spread')
    for output in (outputs[0], outputs[3], outputs[4]):
        room.until(output.get_subscription_count, 'the recorder')
    letters = np.random.default_rng(0).integers(97, 123, (40, 3000)).astype(np.uint8)
    for row in letters:
        for output in outputs:
            output.publish(String(data=row.tobytes().decode()))
    for output in outputs:
        output.wait_for_all_acked()
    assert recorder.stop() == 0, recorder
    for output in outputs:
        room.node.destroy_publisher(output)
    bag = open_bag(tmp_path / 'bag')
    assert {name: t.count for name, t in bag.topics.items()} == {
        '/a/one': 40, '/a/three': 40, '/flock/spread': 40,
    }  # fmt: skip
    assert len(bag.storages) > 1
    assert {c for storage in bag.storages for c in storage.compressions} == {'zstd'}
    with AnyReader([tmp_path / 'bag']) as reader:
        assert reader.message_count == bag.count
        assert sum(1 for _ in reader.messages()) == bag.count


def test_every_topic_is_recorded_with_its_type(room: Graph, tmp_path: Path) -> None:
    recorder = start_recorder(room, tmp_path / 'bag', '--all')
    until_recorded(room, recorder, '/rosout', '/diagnostics')
    room.until_status('recorder: recorder', 'recording')
    assert recorder.stop(SIGHUP) == 0, recorder
    assert (tmp_path / 'bag' / 'metadata.yaml').is_file()
    bag = open_bag(tmp_path / 'bag')
    assert bag.topics['/rosout'].type == 'rcl_interfaces/msg/Log'
    assert bag.topics['/rosout'].type_hash.startswith('RIHS01_')
    assert bag.topics['/diagnostics'].count >= 1
    with AnyReader([tmp_path / 'bag']) as reader:
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)


def send_first(graph: Graph, topic: str, kind: Any, qos: Any, row: bytes) -> None:
    """Publish one message as soon as somebody listens, and be gone."""
    output = graph.node.create_publisher(kind, topic, qos)
    until(output.get_subscription_count, f'a reader of {topic}', step=lambda: None)
    output.publish(row)
    output.wait_for_all_acked()
    graph.idle(0.2)
    graph.node.destroy_publisher(output)


def test_the_first_message_of_every_topic_is_there(room: Graph, tmp_path: Path) -> None:
    recorder = start_recorder(room, tmp_path / 'bag', '-x', '/diagnostics')
    text = next(m.data for m in recording()[0] if m.topic == '/episode')  # of two shepherds
    goal = pose(1, 2.0, 3.0)
    command = cdr(tiny_twist(1.0, 2.0))
    sent = [
        ('/goal_pose', PoseStamped, RELIABLE, goal),
        ('/metrics/flock_spread', Float64, RELIABLE, cdr(make('Float64', data=1.0))),
        ('/episode', String, LATCHED, text),
        ('/shepherd_1/scan/goal', LaserScan, RELIABLE, scan_of(3, np.ones(8))),
        # as the contract does not have it
        ('/goal', PoseStamped, RELIABLE, goal),  # not latched
        ('/shepherd_0/cmd_vel', Twist, RELIABLE, command),
        ('/farm/episode', String, LATCHED, text),
    ]
    for topic, kind, qos, row in sent:
        send_first(room, topic, kind, qos, row)
    assert recorder.stop() == 0, recorder
    stored = [(m.topic, m.data.rstrip(b'\0')) for m in open_bag(tmp_path / 'bag').messages()]
    # without padding
    assert stored == [(topic, row.rstrip(b'\0')) for topic, _, _, row in sent], recorder


def test_a_topic_gets_a_second_publisher_that_offers_less(room: Graph, tmp_path: Path) -> None:
    recorder = start_recorder(room, tmp_path / 'bag', '--topics', '/n')
    first = room.publisher('/n', Float64)
    until_recorded(room, recorder, '/n')
    first.publish(Float64(data=1.0))
    assert until_taken(room, 0) == 1
    second = room.publisher('/n', Float64, BEST_EFFORT)
    room.until(lambda: first.get_subscription_count(), 'the recorder')
    for number, output in enumerate((first, second), start=1):
        output.publish(Float64(data=2.0))
        assert until_taken(room, number) == number + 1
    assert recorder.stop() == 0, recorder
    for output in (first, second):
        room.node.destroy_publisher(output)
    stored = [np.frombuffer(m.data[4:12], '<f8')[0] for m in open_bag(tmp_path / 'bag').messages()]
    assert stored == [1.0, 2.0, 2.0]


def test_two_types_on_one_topic_are_refused(room: Graph, tmp_path: Path) -> None:
    recorder = start_recorder(room, tmp_path / 'bag', '--topics', '/n')
    first = room.publisher('/n', Float64)
    until_recorded(room, recorder, '/n')
    other = Graph(room.domain, tmp_path)  # one process cannot have both
    _ = other.node.create_publisher(Int32, '/n', RELIABLE)
    what = (
        '/n is not recorded: it has the types std_msgs/msg/Float64, std_msgs/msg/Int32, expected'
    )
    room.until_says(recorder, what)
    other.close()
    first.publish(Float64(data=1.0))
    first.wait_for_all_acked()
    assert recorder.stop() == 1, recorder
    room.node.destroy_publisher(first)
    assert f'failed: {what}' in recorder.text
    assert open_bag(tmp_path / 'bag').count == 1


def test_log_times_are_those_of_the_simulated_clock(room: Graph, tmp_path: Path) -> None:
    words = ['--topics', '/n', '/clock', '--use-sim-time']
    recorder = start_recorder(room, tmp_path / 'bag', *words)
    clock, output = room.publisher('/clock', Clock), room.publisher('/n', Float64)
    for second in (3, 4, 9):
        for publisher, row in (
            (clock, cdr(make('Clock', clock=make('Time', sec=second, nanosec=5)))),
            (output, cdr(make('Float64', data=1.0))),
        ):
            publisher.publish(row)
            room.idle(0.5)  # so that it is heard before the next
    assert recorder.stop() == 0, recorder
    for publisher in (clock, output):
        room.node.destroy_publisher(publisher)
    bag = open_bag(tmp_path / 'bag')
    assert [m.log_ns for m in bag.messages({'/n'})] == [k * 10**9 + 5 for k in (3, 4, 9)]
    assert [m.log_ns for m in bag.messages({'/clock'})] == [k * 10**9 + 5 for k in (3, 4, 9)]


def test_stop_and_start(room: Graph, tmp_path: Path) -> None:
    recorder = start_recorder(room, tmp_path / 'bag', '--topics', '/n', '--start-paused')
    output = room.publisher('/n', Float64)
    until_recorded(room, recorder, '/n')

    def send(value: float) -> None:
        output.publish(Float64(data=value))
        output.wait_for_all_acked()

    send(1.0)
    assert ask(room, '/recorder/start') == (True, 'recording')
    assert ask(room, '/recorder/start') == (False, 'already recording')
    send(2.0)
    assert ask(room, '/recorder/stop') == (True, 'stopped')
    send(3.0)
    assert ask(room, '/recorder/start')[0]
    send(4.0)
    assert recorder.stop() == 0, recorder
    room.node.destroy_publisher(output)
    stored = [np.frombuffer(m.data[4:12], '<f8')[0] for m in open_bag(tmp_path / 'bag').messages()]
    assert stored == [2.0, 4.0]


@pytest.mark.parametrize(
    ('words', 'printed'),
    [
        (['-o', '{there}'], ['{there}: it exists already; choose another folder']),
        (['-o', '{file}/x/y'], ['{file}/x/y: it cannot be created (', '; choose another folder']),
        (['-o', '{new}', '-e', '(['], ["--regex is '(['", 'expected a regular expression']),
        (['-o', '{new}', '-x', '*a'], ["--exclude is '*a'", 'expected a regular expression']),
        (['-o', '{new}', '--topics', '/a', 'b c'], ["--topics has 'b c'", 'such as /flock/poses']),
        (['-o', '{new}', '--topics', '/a//b'], ["--topics has '/a//b'", 'such as /flock/poses']),
        (['-o', '{new}', '-b', '-1'], ['--max-bag-size is -1', 'expected 0 (never) or more']),
        (['-o', '{new}', '--compression', 'gz'], ['gz', 'zstd']),
    ],
)
def test_a_recorder_refuses_what_cannot_be(
    room: Graph, tmp_path: Path, words: list[str], printed: list[str]
) -> None:
    places = {'there': tmp_path / 'there', 'file': tmp_path / 'file', 'new': tmp_path / 'new'}
    places['there'].mkdir()
    places['file'].touch()
    recorder = room.start_words('recorder', [word.format(**places) for word in words])
    assert recorder.wait() == 2, recorder
    for text in printed:
        assert text.format(**places) in recorder.text
    assert 'Traceback' not in recorder.text
    assert not places['new'].exists()


def test_killed_recorders_leave_all_that_they_have_put_on_the_disk(
    room: Graph, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three of them; 20 times with the whole stack in benchmarks/kill_recorder.py."""
    names = [f'recorder{k}' for k in range(3)]
    recorders = [
        room.start_words(
            'recorder',
            ['-o', str(tmp_path / name), '--topics', f'/{name}/scan',
             '--ros-args', '-r', f'__node:={name}'],
        )
        for name in names
    ]  # fmt: skip
    outputs = [room.publisher(f'/{name}/scan', LaserScan) for name in names]
    for name, recorder, output, count in zip(
        names, recorders, outputs, (200, 1400, 2600), strict=True
    ):
        rows = [scan_of(k, np.full(512, k, np.float32)) for k in range(count)]
        flood(room, output, rows, 2000.0)
        file = tmp_path / name / f'{name}_0.mcap'
        room.until(lambda file=file: file.exists() and file.stat().st_size > 8, 'a bag')
        status = room.status(f'{name}: recorder')
        recorder.send(SIGKILL)
        assert recorder.wait() == -SIGKILL
        printed = {value.key: value.value for value in status.values} if status else {}
        assert main(['bag', 'info', str(tmp_path / name)]) == 2
        assert 'shepherd bag recover' in capsys.readouterr().err
        assert main(['bag', 'recover', str(tmp_path / name)]) == 0
        again = tmp_path / f'{name}_recovered'
        stored = [message.data for message in open_bag(again).messages()]
        assert stored == rows[: len(stored)]
        whole = 0  # that another reader finds in whole chunks
        with file.open('rb') as stream, suppress(EndOfFile):
            for record in StreamReader(stream).records:
                whole += isinstance(record, Message)
        assert len(stored) >= max(whole, int(printed.get('on_disk', 0)))
        with AnyReader([again]) as reader:
            assert reader.message_count == sum(1 for _ in reader.messages()) == len(stored)


def test_a_disk_that_is_full_ends_the_recorder_with_a_word(room: Graph, tmp_path: Path) -> None:
    recorder = start_recorder(room, tmp_path / 'bag')
    room.until_status('recorder: recorder', 'recording')
    resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (600_000, 600_000))
    output = room.publisher('/shepherd_0/scan/sheep', LaserScan)
    rows = [scan_of(k, np.full(512, k, np.float32)) for k in range(1000)]
    flood(room, output, rows, 2000.0)
    assert recorder.wait() == 1, recorder
    room.node.destroy_publisher(output)
    bag = open_bag(tmp_path / 'bag')
    printed = (
        f'failed: {tmp_path}/bag: it cannot be written (File too large); {bag.count} messages '
    )
    assert printed in recorder.text
    assert f'{bag.count} messages of {len(bag.topics)} topics in' in recorder.text
    assert 'free space or choose another place' in recorder.text
    assert 'Traceback' not in recorder.text
    status = room.until_status('recorder: recorder', 'cannot be written')
    assert status.level == DiagnosticStatus.ERROR
    stored = [message.data for message in bag.messages({'/shepherd_0/scan/sheep'})]
    assert stored == rows[: len(stored)]
    assert 100 < len(stored) < 300
    with AnyReader([tmp_path / 'bag']) as reader:
        assert reader.message_count == sum(1 for _ in reader.messages()) == bag.count


def test_a_bag_says_what_made_it(whole: Run) -> None:
    data = whole.bag.custom_data
    assert data[VERSION_KEY] == __version__
    assert data[CONTRACT_KEY] == contract_hash()
    first = next(whole.bag.messages({'/episode'}))
    assert data[EPISODE_KEY] == decode_string(first.data)
    assert data[LOST_KEY] == '{}'


def test_diagnostics_say_how_fast_it_goes(room: Graph, tmp_path: Path) -> None:
    recorder = start_recorder(room, tmp_path / 'bag', '--topics', '/scan')
    output = room.publisher('/scan', LaserScan)
    flood(room, output, [scan_of(k, np.ones(8, np.float32)) for k in range(300)], 300.0)
    shown: list[dict[str, str]] = []

    def all_there() -> bool:
        status = room.status('recorder: recorder')
        if status is not None:
            shown.append({value.key: value.value for value in status.values})
        return bool(shown) and shown[-1]['on_disk'] == '300'

    room.until(all_there, 'everything is on the disk')
    assert recorder.stop() == 0, recorder
    room.node.destroy_publisher(output)
    assert max(float(values['rate']) for values in shown) > 0
    last = shown[-1]
    assert (last['messages'], last['topics'], last['lost']) == ('300', '1', '0')
    assert last['bag'] == str(tmp_path / 'bag')


# ---- losses ----


def test_a_recorder_that_is_held_up_tells_what_it_lost(room: Graph, tmp_path: Path) -> None:
    recorder = start_recorder(room, tmp_path / 'bag', '--topics', '/flood')
    output = room.publisher('/flood', String, BEST_EFFORT)
    until_recorded(room, recorder, '/flood')
    row = cdr(make('String', data='x' * 500))
    output.publish(row)
    first = until_taken(room, 0)
    recorder.send(SIGSTOP)
    for _ in range(12_000):
        output.publish(row)
    recorder.send(SIGCONT)
    sent = until_heard_again(room, lambda: output.publish(row))
    stored = until_taken(room, first)
    output.publish(row)  # only a later message shows that others are missing
    assert until_taken(room, stored) == stored + 1
    assert recorder.stop() == 1, recorder
    room.node.destroy_publisher(output)
    assert 'the bag is NOT whole' in recorder.text
    lost = re.search(r'lost: /flood: (\d+) missing in the numbering', recorder.text)
    assert lost, recorder
    assert int(lost[1]) > 0
    assert open_bag(tmp_path / 'bag').count + int(lost[1]) == 1 + 12_000 + sent + 1


def test_two_publishers_of_one_topic_are_no_loss(room: Graph, tmp_path: Path) -> None:
    recorder = start_recorder(room, tmp_path / 'bag', '--topics', '/n')
    first = room.publisher('/n', Float64)
    for _ in range(50):
        first.publish(Float64())
    second = room.publisher('/n', Float64)
    for _ in range(50):
        second.publish(Float64())
        first.publish(Float64())
    for output in (first, second):
        output.wait_for_all_acked()
    assert recorder.stop() == 0, recorder
    for output in (first, second):
        room.node.destroy_publisher(output)
    assert open_bag(tmp_path / 'bag').count == 150


@pytest.mark.parametrize('qos', [RELIABLE, BEST_EFFORT], ids=['reliable', 'best effort'])
def test_four_thousand_scans_per_second_are_there_or_told_as_lost(
    room: Graph, tmp_path: Path, qos: Any
) -> None:
    recorder = start_recorder(room, tmp_path / 'bag', '--topics', '/scan')
    output = room.publisher('/scan', LaserScan, qos)
    rows = [scan_of(k, np.full(512, k, np.float32)) for k in range(4000)]
    flood(room, output, rows[:-1], 4000.0)
    stored = until_taken(room, 0)
    output.publish(rows[-1])  # only a later message shows that others are missing
    assert until_taken(room, stored) == stored + 1
    code = recorder.stop()
    room.node.destroy_publisher(output)
    bag = open_bag(tmp_path / 'bag')
    lost = json.loads(bag.custom_data[LOST_KEY])
    assert code == bool(lost), recorder
    assert lost == ({'/scan': len(rows) - bag.count} if lost else {})
    written = [message.data for message in bag.messages()]
    assert set(written) <= set(rows)
    assert written == sorted(written, key=rows.index)
    if qos is RELIABLE:
        assert written == rows, recorder


def test_what_is_lost_is_told_everywhere(room: Graph, tmp_path: Path) -> None:
    """Two publishers of one topic send more than a recorder that is held up can keep."""
    recorder = start_recorder(room, tmp_path / 'bag', '-x', '/diagnostics')
    outputs = [room.publisher('/flock/poses', PoseArray, BEST_EFFORT) for _ in range(2)]
    until_recorded(room, recorder, '/flock/poses')
    row = poses(1, np.ones((9, 2)), np.ones((9, 2)))

    def send(count: int) -> None:
        for _ in range(count):
            for output in outputs:
                output.publish(row)

    received = 0

    def both_are_heard() -> bool:  # the recorder finds them one after the other
        nonlocal received
        before = received
        send(1)
        received = until_taken(room, before)
        return received == before + 2

    room.until(both_are_heard, 'both publishers')
    recorder.send(SIGSTOP)
    send(8000)
    recorder.send(SIGCONT)
    sent = until_heard_again(room, lambda: send(1))
    stored = until_taken(room, received)
    send(3)  # only later messages show that others are missing
    assert until_taken(room, stored) == stored + 6
    values = counts(room)
    status = room.until_status('recorder: recorder', f'{values["lost"]} messages were lost')
    assert recorder.stop() == 1, recorder
    for output in outputs:
        room.node.destroy_publisher(output)
    bag = open_bag(tmp_path / 'bag')
    lost = received + 2 * (8000 + sent + 3) - bag.topics['/flock/poses'].count
    assert lost > 0
    assert status.level == DiagnosticStatus.WARN
    assert values['lost'] == values['lost /flock/poses'] == str(lost)
    assert json.loads(bag.custom_data[LOST_KEY]) == {'/flock/poses': lost}
    assert f'lost: /flock/poses: {lost} missing in the numbering' in recorder.text
    assert f'lost: /flock/poses: {lost} messages' in check_bag(bag).text()


# ---- the player ----


def test_late_readers_get_what_is_latched(room: Graph, tmp_path: Path) -> None:
    bag = tiny_bag(tmp_path / 'bag')
    player = room.start_words('player', [str(bag), '--start-paused', '--rate', '50'])
    room.until_nodes('player')
    room.idle(0.5)
    assert player.code is None, player
    with hearing(room, '/flock/poses', PoseArray) as poses:
        room.until(lambda: room.node.count_publishers('/flock/poses'), 'the player')
        assert not poses
        room.idle(0.2)
        assert room.set_parameter('/player', 'step_size', 3) == (True, '')
        assert room.trigger('/player/step') == '3 messages, then paused'
        room.idle(0.5)
        with hearing(room, '/episode', String, LATCHED) as episodes:
            room.until(lambda: episodes, 'the episode, which was played before')
        pause(room, False)
        assert player.wait() == 0, player
        room.until(lambda: len(poses) == 10, 'every pose')


def test_step_plays_as_many_as_asked_for(room: Graph, tmp_path: Path) -> None:
    bag = values(tmp_path / 'bag', 50)
    with hearing(room, '/metrics/flock_spread', Float64) as received:
        player = room.start_words('player', [str(bag), '-p', '--wait', '10'])
        for n, total in ((1, 1), (7, 8), (2, 10)):
            assert n == 1 or room.set_parameter('/player', 'step_size', n) == (True, '')
            assert room.trigger('/player/step') == f'{n} messages, then paused'
            room.until(lambda total=total: len(received) == total, f'{total} messages')
            room.idle(0.15)
            assert len(received) == total
        taken, reason = room.set_parameter('/player', 'step_size', 0)
        assert not taken
        assert 'step_size out of range' in reason
        assert len(received) == 10
        assert player.stop() == 0, player
        assert '10 messages of 1 topics' in player.text


def test_a_pause_holds_the_message_that_is_next(room: Graph, tmp_path: Path) -> None:
    bag = values(tmp_path / 'bag', 2, gap_ns=2_000_000_000)
    with hearing(room, '/metrics/flock_spread', Float64) as received:
        player = room.start_words('player', [str(bag), '-p', '--wait', '10'])
        pause(room, False)
        room.until(lambda: received, 'the first message')
        pause(room, True)
        room.idle(2.2)
        assert len(received) == 1
        pause(room, False)
        assert player.wait() == 0, player
        room.until(lambda: len(received) == 2, 'the second message')


def test_loop_repeats(room: Graph, tmp_path: Path) -> None:
    bag = values(tmp_path / 'bag', 5)
    with hearing(room, '/metrics/flock_spread', Float64) as received:
        player = room.start_words('player', [str(bag), '--loop', '--wait', '10'])
        room.until(lambda: len(received) > 12, 'the third time')
        assert player.stop() == 0, player
    numbers = [int(np.frombuffer(raw[4:12], '<f8')[0]) for raw in received]
    assert numbers == [k % 5 for k in range(len(numbers))]


def test_start_offset_and_until(room: Graph, tmp_path: Path) -> None:
    bag = tiny_bag(tmp_path / 'bag')
    start, end = 0.03, 0.05  # messages are 1 ms apart
    sent = recording()[0]
    expected = [m.data for m in sent[30:50] if m.topic == '/flock/poses']
    with (
        hearing(room, '/flock/poses', PoseArray) as poses,
        hearing(room, '/episode', String, LATCHED) as episodes,
    ):
        words = [str(bag), '--start-offset', str(start), '--until', str(end), '--wait', '2']
        player = room.start_words('player', words)
        assert player.wait() == 0, player
        room.until(lambda: len(poses) == len(expected) and episodes, 'what was played')
    assert poses == expected
    (episode,) = episodes
    expected_episode = next(m.data for m in sent if m.topic == '/episode')
    assert episode.rstrip(b'\0') == expected_episode.rstrip(b'\0')  # padding is not content


def test_there_is_never_a_second_clock(room: Graph, tmp_path: Path) -> None:
    bag = tiny_bag(tmp_path / 'bag')
    with hearing(room, '/clock', Clock, BEST_EFFORT) as clock:
        played = [str(bag), '-p', '--clock', '50']
        player = room.start_words('player', played)
        room.until(lambda: room.node.count_publishers('/clock'), 'a clock')
        room.idle(0.3)
        assert room.node.count_publishers('/clock') == 1
        assert not clock
        assert player.stop() == 0, player
        room.until(lambda: not room.node.count_publishers('/clock'), 'no clock')
        words = [str(bag), '--topics', '/flock/poses', '--clock', '50', '--rate', '0.2']
        player = room.start_words('player', words)
        room.until(lambda: len(clock) > 3, 'time')
        assert room.node.count_publishers('/clock') == 1
        assert player.stop() == 0, player


@pytest.mark.parametrize(
    ('words', 'printed'),
    [
        (['{bag}', '--topics', '/wool'], ['--topics has /wool', 'expected some of /clock']),
        (['{bag}', '--rate', '-1'], ['--rate is -1.0', 'expected a number above 0']),
        (['{bag}', '--start-offset', 'inf'], ['--start-offset is inf', 'expected 0 or more']),
        (['{none}'], ['{none}: there is no such file or folder; check the path']),
        (['{empty}'], ['{empty}: it is empty; ']),
        (['{odd}'], ["{odd}: '/a//b' is no name of a topic in ROS 2; choose others"]),
        (['{foreign}'], ["/x has the type 'wool_msgs/msg/Sheep'", 'not installed', '--topics']),
    ],
)
def test_a_player_refuses_what_cannot_be(
    room: Graph, tmp_path: Path, words: list[str], printed: list[str]
) -> None:
    places = {name: tmp_path / name for name in ('bag', 'none', 'empty', 'foreign', 'odd')}
    tiny_bag(places['bag'])
    places['empty'].touch()
    with BagWriter(places['foreign']) as writer:
        schema = 'ros2msg', b'float64 x\n'
        writer.add_topic('/x', 'wool_msgs/msg/Sheep', [Qos()], schema=schema)
        writer.write('/x', bytes(12), 1, 1)
    with BagWriter(places['odd']) as writer:
        writer.add_topic(
            '/a//b', 'std_msgs/msg/Int32', [Qos()], schema=('ros2msg', b'int32 data\n')
        )
        writer.write('/a//b', bytes(8), 1, 1)
    player = room.start_words('player', [word.format(**places) for word in words])
    seen = set()

    def has_ended() -> bool:
        seen.update(room.node.get_node_names())
        return player.code is not None

    room.until(has_ended, 'it ends')
    assert player.code == 2, player
    for text in printed:
        assert text.format(**places) in player.text
    assert 'Traceback' not in player.text
    assert seen == {'probe'}, 'it joined the graph'


def test_a_foreign_bag_is_played_if_its_types_are_installed(room: Graph, tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bag') as writer:
        schema = 'ros2msg', b'int32 data\n'
        writer.add_topic('/wool', 'std_msgs/msg/Int32', [Qos()], schema=schema)
        writer.write('/wool', b'\0\1\0\0\7\0\0\0', 1, 1)
    with hearing(room, '/wool', Int32) as received:
        player = room.start_words('player', [str(tmp_path / 'bag'), '--wait', '10'])
        assert player.wait() == 0, player
        room.until(lambda: received == [b'\0\1\0\0\7\0\0\0'], 'the message')


def _integer(name: str, value: int) -> Any:
    """Return an argument of a service."""
    return Parameter(name, value=value).to_parameter_msg()
