"""Bags as they are written: every reader opens them, and a crash or a full disk costs little."""

from __future__ import annotations

from collections import Counter
import json
from pathlib import Path
import resource
import signal
import subprocess
import sys
from typing import Any

from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
import pytest
from rosbag2.tiny import cdr, LOG_START_NS, make, recording, STORE, tiny_bag
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
import shepherd_ros
from shepherd_ros.config import ConfigError
from shepherd_ros.recordings.recording_writer import RecordingWriter
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.rosbag2.metadata import Metadata
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.rosbag2.recover import recover
from shepherd_ros.wire.contract import contract_hash, known, topic_hashes, type_hash
from shepherd_ros.wire.schemas import schema_text, wire_types
import yaml

ROOT = Path(__file__).resolve().parents[2]
MESSAGES = recording()[0]
KINDS = ['none', 'zstd', 'lz4']
STRING = 'std_msgs/msg/String'


def lines(path: Path, code: str, **options: Any) -> subprocess.Popen[str]:
    """Start Python with a bag's path as its argument."""
    return subprocess.Popen(
        [sys.executable, '-c', code, str(path)], cwd=ROOT, stdout=subprocess.PIPE, text=True,
        **options,
    )  # fmt: skip


def ros2(path: Path) -> list[Any]:
    """Return what mcap_ros2 decodes of a file."""
    with path.open('rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return list(reader.iter_decoded_messages())


# ---- all readers ----


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('chunk_size', [1, 5000, 1 << 20])
def test_every_reader_sees_what_was_written(tmp_path: Path, kind: str, chunk_size: int) -> None:
    folder = tiny_bag(tmp_path / 'bag', compression=kind, chunk_size=chunk_size)
    sent = [(m.topic, m.type, m.log_ns, m.publish_ns, m.data) for m in MESSAGES]
    assert [tuple(message) for message in open_bag(folder).messages()] == sent
    (file,) = folder.glob('*.mcap')
    assert file.name == 'bag_0.mcap'
    assert [tuple(message) for message in open_bag(file).messages()] == sent
    for reader in (Reader(folder), AnyReader([folder]), AnyReader([file])):
        with reader:
            rows = [
                (c.topic, c.msgtype, ns, bytes(data))
                for c, ns, data in reader.messages(reader.connections)
            ]
        assert rows == [(m.topic, m.type, m.log_ns, m.data) for m in MESSAGES]
    with file.open('rb') as stream:
        reference = [
            (c.topic, s and s.name, m.log_time, m.publish_time, m.data)
            for s, c, m in make_reader(stream, validate_crcs=True).iter_messages()
        ]
    assert reference == sent


@pytest.mark.parametrize('kind', KINDS)
def test_mcap_ros2_decodes_equal_values(tmp_path: Path, kind: str) -> None:
    folder = tiny_bag(tmp_path / 'bag', compression=kind)
    for own, (_, channel, _, reference) in zip(MESSAGES, ros2(folder / 'bag_0.mcap'), strict=True):
        assert channel.topic == own.topic
        expected: Any = STORE.deserialize_cdr(own.data, own.type)
        if own.type.endswith('LaserScan'):
            assert reference.ranges == expected.ranges.tolist()
        elif own.type.endswith('PoseArray'):
            xy = [(p.position.x, p.position.y) for p in reference.poses]
            assert xy == [(p.position.x, p.position.y) for p in expected.poses]
        elif own.type.endswith('TwistStamped'):
            assert reference.twist.linear.x == expected.twist.linear.x


def test_the_file_is_what_rosbag2_writes(tmp_path: Path) -> None:
    folder = tiny_bag(tmp_path / 'bag')
    with (folder / 'bag_0.mcap').open('rb') as stream:
        reader = make_reader(stream)
        header, summary = reader.get_header(), reader.get_summary()
        notes = list(reader.iter_metadata())
    assert header.profile == 'ros2'
    assert summary is not None
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (schema.encoding, channel.message_encoding) == ('ros2msg', 'cdr')
        assert schema.data.decode() == schema_text(schema.name)
        assert set(channel.metadata) == {'offered_qos_profiles', 'topic_type_hash'}
        assert channel.metadata['topic_type_hash'] == type_hash(schema.name)
        (profile,) = yaml.safe_load(channel.metadata['offered_qos_profiles'])
        latched = channel.topic in ('/episode', '/goal')
        assert profile['durability'] == ('transient_local' if latched else 'volatile')
    # written on opening and again on closing, equal to metadata.yaml then
    assert [note.name for note in notes] == ['rosbag2', 'rosbag2']
    first, last = (yaml.safe_load(note.metadata['serialized_metadata']) for note in notes)
    assert first['message_count'] == 0
    assert first['custom_data']['shepherd_ros.contract'] == contract_hash()
    document = yaml.safe_load((folder / 'metadata.yaml').read_text())
    assert document == {'rosbag2_bagfile_information': last}


def test_metadata_counts_what_is_there(tmp_path: Path) -> None:
    folder = tiny_bag(tmp_path / 'bag')
    metadata = yaml.safe_load((folder / 'metadata.yaml').read_text())
    inner = metadata['rosbag2_bagfile_information']
    times = [m.log_ns for m in MESSAGES]
    assert inner['starting_time'] == {'nanoseconds_since_epoch': min(times)}
    assert inner['duration'] == {'nanoseconds': max(times) - min(times)}
    assert inner['message_count'] == len(MESSAGES)
    counts = {
        row['topic_metadata']['name']: row['message_count']
        for row in inner['topics_with_message_count']
    }
    assert counts == Counter(m.topic for m in MESSAGES)
    assert inner['files'] == [
        {
            'path': 'bag_0.mcap',
            'starting_time': inner['starting_time'],
            'duration': inner['duration'],
            'message_count': len(MESSAGES),
        }
    ]
    assert inner['relative_file_paths'] == ['bag_0.mcap']


def test_the_bag_explains_itself(tmp_path: Path) -> None:
    data = open_bag(tiny_bag(tmp_path / 'bag', custom_data={'run': '12'})).custom_data
    episode = STORE.deserialize_cdr(MESSAGES[0].data, STRING)
    assert data == {
        'run': '12',
        'shepherd_ros.version': shepherd_ros.__version__,
        'shepherd_ros.contract': contract_hash(),
        'shepherd_ros.topics': json.dumps(topic_hashes(), separators=(',', ':')),
        'shepherd_ros.episode': episode.data,  # type: ignore[attr-defined]
    }


def test_an_empty_bag_can_be_read(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/episode', STRING)
    bag = open_bag(tmp_path / 'bag')
    assert (bag.count, list(bag.messages()), list(bag.topics)) == (0, [], ['/episode'])
    with Reader(tmp_path / 'bag') as reader:
        assert (reader.message_count, list(reader.messages())) == (0, [])


def test_the_files_of_a_hidden_folder_are_not_hidden(tmp_path: Path) -> None:
    """A folder gets its name when it is whole, and `cp bag/*` has to find its files."""
    tiny_bag(tmp_path / '.bag').rename(tmp_path / 'bag')
    assert [path.name for path in (tmp_path / 'bag').glob('*.mcap')] == ['bag_0.mcap']
    assert open_bag(tmp_path / 'bag').count == len(MESSAGES)


# ---- splits ----


@pytest.mark.parametrize('how', [{'split_bytes': 6_000}, {'split_seconds': 0.03}])
def test_split_bags_are_one_bag(tmp_path: Path, how: dict[str, float]) -> None:
    folder = tiny_bag(tmp_path / 'bag', chunk_size=3000, **how)
    found = {path.name for path in folder.glob('*.mcap')}
    names = [f'bag_{k}.mcap' for k in range(len(found))]
    assert found == set(names)
    assert 3 <= len(names) <= 8
    metadata = Metadata.from_yaml((folder / 'metadata.yaml').read_text(), folder)
    assert [file.path for file in metadata.files] == names
    assert sum(file.count for file in metadata.files) == len(MESSAGES)
    sent = [(m.topic, m.log_ns, m.data) for m in MESSAGES]
    assert [(m.topic, m.log_ns, m.data) for m in open_bag(folder).messages()] == sent
    for reader in (Reader(folder), AnyReader([folder])):
        with reader:
            rows = reader.messages(reader.connections)
            assert [(c.topic, ns, bytes(data)) for c, ns, data in rows] == sent
    for file in folder.glob('*.mcap'):  # each can be read on its own
        assert open_bag(file).topics.keys() <= open_bag(folder).topics.keys()


# ---- mistakes ----


def test_contract_and_types_have_stable_hashes() -> None:
    assert len(contract_hash()) == 64
    for kind in wire_types():
        assert type_hash(kind).startswith('RIHS01_')
    expected = 'RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18'
    assert type_hash(STRING) == expected  # as ROS 2 Jazzy ships it


def test_topics_of_the_contract_are_known_in_any_namespace() -> None:
    scan = known('/field/a/shepherd_12/scan/goal')
    assert scan is not None
    assert (scan.namespace, scan.shepherd) == ('/field/a', 12)
    assert scan.topic.name == 'shepherd_{h}/scan/goal'
    goal = known('/goal')
    assert goal is not None
    assert (goal.namespace, goal.topic.name) == ('', 'goal')
    assert known('/clock') is not None
    assert known('/a/clock') is known('/tf') is known('/shepherd_x/cmd_vel') is None


def test_an_existing_folder_is_not_touched(tmp_path: Path) -> None:
    folder = tiny_bag(tmp_path / 'bag')
    before = {path: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(BagError, match='it exists already; choose another folder'):
        RecordingWriter(folder)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


def test_a_place_where_nothing_can_be_written(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(BagError, match=r'file/bag: it cannot be created .Not a directory.; free'):
        RecordingWriter(tmp_path / 'file' / 'bag')


@pytest.mark.parametrize(
    ('options', 'what'),
    [
        ({'compression': 'zst'}, "compression is 'zst': .*did you mean 'zstd'"),
        ({'chunk_size': 0}, 'chunk_size is 0: expected 1'),
        ({'chunk_size': 2**27 + 1}, 'chunk_size is 134217729: expected 1 to 134217728'),
        ({'split_bytes': 1023}, 'split_bytes is 1023'),
        ({'split_bytes': 10}, 'split_bytes is 10: expected 0, or at least 1024'),
        ({'split_seconds': -1.0}, 'split_seconds is -1.0: expected 0 or more'),
        ({'split_seconds': float('nan')}, 'split_seconds is nan'),
    ],
)
def test_wrong_options_are_refused(tmp_path: Path, options: dict[str, Any], what: str) -> None:
    with pytest.raises(ConfigError, match=what):
        RecordingWriter(tmp_path / 'bag', **options)
    assert not (tmp_path / 'bag').exists()


def test_wrong_use_is_refused_and_the_bag_goes_on(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/episode', STRING)
        writer.add_topic('/episode', STRING)
        with pytest.raises(BagError, match='has type std_msgs/msg/String and is offered as'):
            writer.add_topic('/episode', 'std_msgs/msg/Float64')
        with pytest.raises(ConfigError, match="message type is 'std_msgs/msg/Strin': expected"):
            writer.add_topic('/other', 'std_msgs/msg/Strin')
        with pytest.raises(BagError, match='/goal is not in it; call add_topic'):
            writer.write('/goal', b'', 0, 0)
        for times in ((-1, 0), (2**63, 0), (0, -1), (0, 2**63)):
            with pytest.raises(BagError, match='expected times in'):
                writer.write('/episode', b'', *times)
        writer.write('/episode', MESSAGES[0].data, 5, 4)
        assert writer.count == 1
    with pytest.raises(BagError, match='the bag is closed'):
        writer.write('/episode', b'', 0, 0)
    assert open_bag(tmp_path / 'bag').count == 1


def test_times_are_kept_from_the_first_nanosecond_to_the_last(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/t', STRING)
        for times in ((0, 2**63 - 1), (2**63 - 1, 0)):
            writer.write('/t', MESSAGES[0].data, *times)
    bag = open_bag(tmp_path / 'bag')
    assert (bag.start_ns, bag.end_ns) == (0, 2**63 - 1)
    assert [m.publish_ns for m in bag.messages()] == [2**63 - 1, 0]


def test_a_file_is_split_by_the_time_since_its_first_message_and_by_its_bytes(
    tmp_path: Path,
) -> None:
    content = cdr(make('String', data='x' * 991))  # 1000 bytes
    for name, options, counts in (
        ('late', {'split_seconds': 2.0}, [2, 1, 2]),
        ('large', {'split_bytes': 2062}, [2, 2, 1]),  # a message has 31 bytes more
        ('larger', {'split_bytes': 2063}, [2, 3]),  # the first file has the topic among them
    ):
        with RecordingWriter(tmp_path / name, **options) as writer:  # type: ignore[arg-type]
            writer.add_topic('/t', STRING)
            for seconds in (0.0, 2.0, 2.5, 5.0, 7.0):
                writer.write('/t', content, int(seconds * 1e9), 0)
            assert writer.metadata().files[-1].path == f'{name}_{len(counts) - 1}.mcap'
        bag = open_bag(tmp_path / name)
        assert [storage.count for storage in bag.storages] == counts, name
        assert bag.topics['/t'].count == sum(counts)


def test_a_type_from_elsewhere_comes_with_its_text(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/n', 'own_msgs/msg/N', schema=('ros2msg', b'int32 n\n'), hash_text='H')
        writer.write('/n', b'\0\1\0\0\7\0\0\0', 1, 1)
    (message,) = ros2(tmp_path / 'bag' / 'bag_0.mcap')
    assert message.decoded_message.n == 7


def test_a_mistake_outside_does_not_cost_the_bag(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), RecordingWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/episode', STRING)
        writer.write('/episode', MESSAGES[0].data, 5, 4)
        _ = 1 / 0
    assert open_bag(tmp_path / 'bag').count == 1


# ---- crash and full disk ----

WRITE_FOREVER = """
import sys
from shepherd_ros.recordings.recording_writer import RecordingWriter
with RecordingWriter(sys.argv[1], chunk_size=16384) as writer:
    writer.add_topic('/t', 'std_msgs/msg/String')
    for k in range(10**9):
        text = f'{k:0>991}'.encode() + bytes(1)
        writer.write('/t', b'\\0\\1\\0\\0' + len(text).to_bytes(4, 'little') + text, k, k)
        if k % 100 == 0:
            print(k, flush=True)
"""


def test_kill_costs_at_most_one_chunk(tmp_path: Path) -> None:
    with lines(tmp_path / 'bag', WRITE_FOREVER) as process:
        assert process.stdout is not None
        while int(process.stdout.readline()) < 500:
            pass
        process.send_signal(signal.SIGKILL)
        rest = process.stdout.read().split('\n')
    printed = max([500, *(int(line) for line in rest if line)])
    with pytest.raises(BagError, match=r'bag_0.mcap: it has no end: .* bag recover'):
        open_bag(tmp_path / 'bag')
    result = recover(tmp_path / 'bag')
    assert printed + 1 - result.messages <= 16384 // 1030 + 1
    times = [message.log_ns for message in open_bag(result.folder).messages()]
    assert times == list(range(result.messages))


def limit_files(size: int) -> None:
    """Let this process write no file beyond a size [bytes], as if the disk were full."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


@pytest.mark.parametrize('size', [33_000, 35_500, 40_000, 100_000, 100_100])
def test_a_full_disk_is_told_and_what_is_there_stays_readable(tmp_path: Path, size: int) -> None:
    code = WRITE_FOREVER.replace('import sys', 'import sys, traceback', 1)
    code = f'try:\n{"".join("    " + line + chr(10) for line in code.splitlines())}'
    code += 'except Exception as error:\n    print(type(error).__name__, error)\n'
    with lines(tmp_path / 'bag', code, preexec_fn=lambda: limit_files(size)) as process:
        assert process.stdout is not None
        output = process.stdout.read().strip().split('\n')[-1]
    assert process.returncode == 0
    stored = open_bag(tmp_path / 'bag').count
    assert output.startswith(
        f'BagError {tmp_path / "bag"}: it cannot be written (File too large); '
    )
    assert f'{stored} messages are kept; free space or choose another place' in output
    assert (tmp_path / 'bag' / 'metadata.yaml').exists()
    assert (size - 12_000) // 1030 - 32 <= stored <= size // 1030
    times = [message.log_ns for message in open_bag(tmp_path / 'bag').messages()]
    assert times == list(range(stored))
    with Reader(tmp_path / 'bag') as reader:
        assert reader.message_count == stored


def test_a_chunk_on_the_disk_can_be_read_while_the_recording_goes_on(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/t', STRING)
        for k in range(3):
            writer.write('/t', MESSAGES[0].data, LOG_START_NS + k, 0)
            writer.flush()
        seen = 0
        with (tmp_path / 'bag' / 'bag_0.mcap').open('rb') as stream, pytest.raises(EndOfFile):
            for record in StreamReader(stream).records:
                seen += isinstance(record, Message)
        assert seen == 3
