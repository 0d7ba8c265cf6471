"""Reading: whole bags, parts of them, bags of others, and broken ones."""

from __future__ import annotations

from itertools import product
from pathlib import Path
import shutil
import struct
import tracemalloc

from mcap.data_stream import RecordBuilder
from mcap.writer import CompressionType, IndexType, Writer
import pytest
from rosbag2.tiny import cdr, LOG_START_NS, make, recording, Sent, STORE, tiny_bag, write
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.rosbag2.enums import StoragePlugin
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from shepherd_ros.recordings.info import bag_info
from shepherd_ros.recordings.recording_writer import RecordingWriter
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.rosbag2.mcap_reader import ChunkRef, Storage
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.rosbag2.records import FOOTER_SIZE, Message
from shepherd_ros.rosbag2.recover import recover
from shepherd_ros.rosbag2.salvage import Salvage
from shepherd_ros.wire.schemas import schema_text

MESSAGES = recording()[0]
SENT = [tuple(message) for message in MESSAGES]


def rows(path: Path, **options: object) -> list[tuple[object, ...]]:
    """Return the messages of a bag as they were sent."""
    messages = open_bag(path).messages(**options)  # type: ignore[arg-type]
    return [(m.topic, m.type, m.data, m.log_ns, m.publish_ns) for m in messages]


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a bag with many chunks in two files."""
    return tiny_bag(tmp_path_factory.mktemp('r') / 'bag', chunk_size=2000, split_bytes=12_000)


def test_topics_are_filtered(bag: Path) -> None:
    for topics in (['/goal'], ['/episode', '/shepherd_1/cmd_vel'], [], ['/nothing']):
        assert rows(bag, topics=topics) == [m for m in SENT if m[0] in topics]


def test_times_are_filtered(bag: Path) -> None:
    first, last = SENT[30][3], SENT[90][3]
    assert rows(bag, start_ns=first) == SENT[30:]
    assert rows(bag, end_ns=last) == SENT[:90]
    assert rows(bag, start_ns=first, end_ns=last, topics=['/clock']) == [
        m for m in SENT[30:90] if m[0] == '/clock'
    ]
    assert rows(bag, start_ns=last, end_ns=first) == []


def test_only_chunks_are_read_that_can_hold_what_is_wanted(
    bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened, places, read = open_bag(bag), [], Storage.read

    def counted(self: Storage, chunk: ChunkRef) -> list[Message]:
        places.append(chunk)
        return read(self, chunk)

    monkeypatch.setattr(Storage, 'read', counted)
    chunks = [(s, chunk) for s in opened.storages for chunk in s.chunks]
    first, last = SENT[30][3], SENT[90][3]
    for topics in (None, ['/goal'], ['/nothing']):
        places.clear()
        list(opened.messages(topics, first, last))
        expected = [
            chunk
            for storage, chunk in chunks
            if chunk.start_ns < last
            and chunk.end_ns >= first
            and (
                topics is None or any(storage.channels[k].topic in topics for k in chunk.channels)
            )
        ]
        assert places == expected
        assert len(expected) < len(chunks)


def test_without_metadata_yaml_the_files_are_found(bag: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(bag, tmp_path / 'copy')
    (copy / 'metadata.yaml').unlink()
    assert rows(copy) == SENT
    assert open_bag(copy).custom_data == open_bag(bag).custom_data
    assert open_bag(copy).metadata_count is None


def test_ten_files_come_after_nine(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/n', 'std_msgs/msg/Float64')
        for k in range(12):
            writer.write('/n', cdr(make('Float64', data=float(k))), k, k)
            if k < 11:
                writer.split()
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    names = [storage.path.name for storage in open_bag(tmp_path / 'bag').storages]
    assert names == [f'bag_{k}.mcap' for k in range(12)]


def test_messages_come_in_the_order_of_their_log_times(tmp_path: Path) -> None:
    shuffled = sorted(MESSAGES, key=lambda m: hash(m.data))
    assert rows(write(tmp_path / 'bag', shuffled, chunk_size=3000)) == SENT


def test_messages_of_one_time_keep_their_order(tmp_path: Path) -> None:
    same = [m._replace(log_ns=LOG_START_NS) for m in MESSAGES]
    assert rows(write(tmp_path / 'bag', same, chunk_size=3000)) == [tuple(m) for m in same]


# ---- bags of others ----


def mcap_of_others(path: Path, messages: list[Sent], **options: object) -> None:
    """Write a file with the library of MCAP, which puts schemas into chunks."""
    with path.open('wb') as stream:
        writer = Writer(stream, **options)  # type: ignore[arg-type]
        writer.start('ros2')
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for topic, kind, data, log_ns, publish_ns in messages:
            if kind not in schemas:
                text = schema_text(kind).encode()
                schemas[kind] = writer.register_schema(kind, 'ros2msg', text)
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, 'cdr', schemas[kind])
            writer.add_message(channels[topic], log_ns, data, publish_ns)
        writer.finish()


@pytest.mark.parametrize(
    'options',
    [
        {'compression': CompressionType.ZSTD, 'chunk_size': 4000},
        {'compression': CompressionType.LZ4, 'chunk_size': 4000},
        {'use_chunking': False},
        {'index_types': IndexType.NONE, 'chunk_size': 4000},
        {'index_types': IndexType.CHUNK, 'chunk_size': 4000},
        {'repeat_channels': False, 'repeat_schemas': False},
        {'use_statistics': False, 'use_summary_offsets': False},
        {
            'index_types': IndexType.NONE, 'repeat_channels': False, 'repeat_schemas': False,
            'use_statistics': False, 'use_summary_offsets': False, 'enable_crcs': False,
        },
    ],
    ids=str,
)  # fmt: skip
def test_files_of_the_mcap_library(tmp_path: Path, options: dict[str, object]) -> None:
    path = tmp_path / 'theirs.mcap'
    mcap_of_others(path, list(MESSAGES), **options)
    assert rows(path) == SENT
    bag = open_bag(path)
    assert (bag.count, bag.start_ns, bag.end_ns) == (len(SENT), SENT[0][3], SENT[-1][3])
    assert bag.topics['/clock'].count == 10
    assert rows(path, topics=['/goal']) == [m for m in SENT if m[0] == '/goal']


def test_messages_outside_chunks_are_read_a_mebibyte_at_a_time(tmp_path: Path) -> None:
    text = cdr(make('String', data='x' * 400_000))
    sent = [Sent('/t', 'std_msgs/msg/String', text, k, k) for k in (5, 1, 2, 9, 7, 8)]
    mcap_of_others(tmp_path / 'runs.mcap', sent, use_chunking=False)
    (storage,) = open_bag(tmp_path / 'runs.mcap').storages
    assert [(ref.start_ns, ref.end_ns) for ref in storage.chunks] == [(1, 5), (2, 9), (7, 8)]
    assert [len(storage.read(ref)) for ref in storage.chunks] == [2, 2, 2]
    assert [row[3] for row in rows(tmp_path / 'runs.mcap')] == [1, 2, 5, 7, 8, 9]


def test_an_index_or_a_footer_that_points_elsewhere_is_damage(tmp_path: Path) -> None:
    path = tmp_path / 'bad.mcap'
    mcap_of_others(path, list(MESSAGES), chunk_size=4000, enable_crcs=False)
    data = path.read_bytes()
    summary, offsets = struct.unpack_from('<QQ', data, len(data) - 28)
    (chunk, *_) = open_bag(path).storages[0].chunks
    index = data.index(struct.pack('<QQ', chunk.offset, chunk.length), summary)  # after two times
    elsewhere = 'the index names a chunk that is not there'
    last = len(data) - FOOTER_SIZE
    for place, value, what in (
        (index, chunk.offset + chunk.length, elsewhere),  # its message index
        (index + 8, chunk.length - 1, elsewhere),
        (index + 8, len(data) - chunk.offset + 1, elsewhere),
        (index - 16, chunk.start_ns + 1, 'a message outside the time of its chunk'),
        (index - 8, chunk.end_ns - 1, 'a message outside the time of its chunk'),
        (len(data) - 28, 7, 'a summary at 7'),
        (len(data) - 28, offsets + 1, f'a summary at {offsets + 1}'),
        (len(data) - 20, last + 1, f'a summary at {summary}'),
    ):
        changed = bytearray(data)
        struct.pack_into('<Q', changed, place, value)
        path.write_bytes(changed)
        with pytest.raises(BagError, match=what):
            rows(path)
    path.write_bytes(data)
    assert rows(path) == SENT


FORMS = ('use_chunking', 'repeat_channels', 'repeat_schemas', 'use_statistics',
         'use_summary_offsets', 'enable_crcs')  # fmt: skip
INDEXES = (IndexType.ALL, IndexType.NONE, IndexType.CHUNK, IndexType.MESSAGE)


@pytest.mark.parametrize('padding', [b'', b'\1\2\3'], ids=['plain', 'padded'])
def test_every_form_that_the_format_allows_opens(
    tmp_path: Path, padding: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As MCAP's conformance files: all combinations of what a writer may leave out or add."""
    finish = RecordBuilder.finish_record

    def finish_padded(self: RecordBuilder) -> None:  # what may be longer than today's readers know
        if padding and self._buffer.getvalue()[self._record_start_offset] not in (2, 5, 6):
            self.write(padding)
        finish(self)

    monkeypatch.setattr(RecordBuilder, 'finish_record', finish_padded)
    path = tmp_path / 'form.mcap'
    for flags in product((True, False), repeat=len(FORMS)):
        for index, count in product(INDEXES, (0, 1, 10)):
            with path.open('wb') as stream:
                options = dict(zip(FORMS, flags, strict=True))
                writer = Writer(stream, index_types=index, chunk_size=60, **options)
                writer.start('')
                schema = writer.register_schema('A', 'c', b'd')
                channels = [writer.register_channel('/a', 'e', schema),
                            writer.register_channel('/b', 'e', 0)]  # fmt: skip
                writer.add_attachment(1, 2, 'n', 't', b'data')
                writer.add_metadata('m', {'k': 'v'})
                for k in range(count):
                    writer.add_message(channels[k % 2], k, bytes([k]), k)
                writer.finish()
            expected = [(('/a', '/b')[k % 2], ('A', '')[k % 2], bytes([k]), k, k)
                        for k in range(count)]  # fmt: skip
            assert rows(path) == expected, (options, index)
            assert open_bag(path).count == count
            salvage = Salvage(path)
            assert [m.log_ns for m in salvage] == list(range(count)), (options, index)
            assert salvage.unsupported == {'attachments': 1}


@pytest.mark.parametrize('version', [8, 9])
def test_bags_of_rosbags(tmp_path: Path, version: int) -> None:
    folder = tmp_path / 'theirs'
    with RosbagsWriter(folder, version=version, storage_plugin=StoragePlugin.MCAP) as writer:  # type: ignore[arg-type]
        connections = {}
        for topic, kind, data, log_ns, _ in MESSAGES:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], log_ns, data)
    assert [row[:2] + row[2:4] for row in rows(folder)] == [m[:4] for m in SENT]


def test_sqlite_opens_with_its_profiles(tmp_path: Path) -> None:
    for version in (8, 9):
        folder = tmp_path / f'v{version}'
        with RosbagsWriter(folder, version=version) as writer:  # type: ignore[arg-type]
            connections = {}
            for topic, kind, data, log_ns, _ in MESSAGES:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
                writer.write(connections[topic], log_ns, data)
        assert [row[:4] for row in rows(folder)] == [m[:4] for m in SENT]
        assert [row[:4] for row in rows(folder, topics=['/goal'], start_ns=SENT[60][3])] == [
            m[:4] for m in SENT[60:] if m[0] == '/goal'
        ]
        assert rows(folder, topics=['/nothing']) == []
        info = bag_info(open_bag(folder))
        assert (info.storage, info.messages, len(info.episodes)) == ('sqlite3', len(SENT), 2)
        assert (info.start_ns, info.end_ns) == (SENT[0][3], SENT[-1][3])
        assert info.size > 10_000


def test_bags_of_ros_1_become_cdr(tmp_path: Path) -> None:
    """Headers have a number there, and types of their own come along."""
    old = get_typestore(Stores.ROS1_NOETIC)
    old.register(get_types_from_msg('std_msgs/Header header\nint32 n', 'wool_msgs/msg/Sheep'))
    header, time = (old.types[f'{p}/msg/{n}'] for p, n in
                    (('std_msgs', 'Header'), ('builtin_interfaces', 'Time')))  # fmt: skip
    sheep = old.types['wool_msgs/msg/Sheep'](header(9, time(3, 4), 'world'), 7)
    text = old.types['std_msgs/msg/String']('meadow')
    with Ros1Writer(tmp_path / 'old.bag') as writer:
        for topic, message, latching in (('/sheep', sheep, 0), ('/map', text, 1)):
            kind = message.__msgtype__
            connection = writer.add_connection(topic, kind, typestore=old, latching=latching)
            writer.write(connection, 5, old.serialize_ros1(message, kind))
    bag = open_bag(tmp_path / 'old.bag')
    first, last = sorted(bag.messages(), key=lambda m: m.topic)
    assert first == ('/map', 'std_msgs/msg/String', 5, 5, cdr(make('String', data='meadow')))
    assert last.data[4:16] == struct.pack('<iII', 3, 4, 6)
    assert last.data[-4:] == struct.pack('<i', 7)
    ((_, encoding, written),) = bag.definitions['/sheep']
    assert (encoding, b'uint32 seq' in written, b'int32 n' in written) == ('ros2msg', False, True)
    assert [t.qos[0].durability for t in bag.topics.values()] == ['transient_local', 'volatile']
    assert 'Storage id:        bag\n' in bag_info(bag).text()


# ---- what cannot be read ----


def test_what_is_no_bag_is_refused_in_words(bag: Path, tmp_path: Path) -> None:
    (tmp_path / 'empty.mcap').write_bytes(b'')
    (tmp_path / 'text.mcap').write_text('a text that is long enough to be something')
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'sub').mkdir()
    for path, what in (
        ('none', 'there is no such file or folder; check the path'),
        ('none/deeper', 'there is no such file or folder'),
        ('text.mcap/deeper', 'there is no such file or folder'),
        ('x' * 300, 'it cannot be read .File name too long.'),
        ('empty.mcap', 'it is empty; there is nothing to recover'),
        ('text.mcap', 'it is no MCAP file; expected a bag'),
        ('folder', 'it holds no .mcap file; expected the folder of a bag'),
    ):
        with pytest.raises(BagError, match=what):
            open_bag(tmp_path / path)
    file = next(bag.glob('*.mcap'))
    data = file.read_bytes()
    for size, what in ((8, 'it has no end'), (30, 'it has no end'), (len(data) - 1, 'no end')):
        (tmp_path / 'cut.mcap').write_bytes(data[:size])
        with pytest.raises(BagError, match=f'cut.mcap: .*{what}.*shepherd bag recover'):
            open_bag(tmp_path / 'cut.mcap')


def test_metadata_that_names_other_files_is_refused(bag: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(bag, tmp_path / 'copy')
    note = copy / 'metadata.yaml'
    text = note.read_text()
    (copy / 'bag_1.mcap').rename(copy / 'other.mcap')
    with pytest.raises(BagError, match=r'bag_1.mcap: it is not there, but metadata.yaml names it'):
        open_bag(copy)
    for old, new, what in (
        ('bag_1.mcap', '../../nothing.mcap', r'copy/nothing.mcap: it is not there'),
        (
            'storage_identifier: mcap',
            'storage_identifier: sqlite3',
            'copy: it cannot be read',
        ),
        (
            "compression_mode: ''",
            'compression_mode: FILE',
            'copy: it cannot be read',
        ),
        ('version', '  version', 'its metadata is no YAML'),
        ('message_count', 'count', 'its metadata cannot be read'),
    ):
        note.write_text(text.replace(old, new))
        with pytest.raises(BagError, match=what):
            open_bag(copy)
    note.write_bytes(b'\xff\xfe\0')
    with pytest.raises(BagError, match='it is no text; run `shepherd bag recover'):
        open_bag(copy)


def test_what_is_advised_keeps_the_other_files(bag: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(bag, tmp_path / 'copy')
    last = sorted(copy.glob('*.mcap'))[-1]
    advice = f'{last}: .*run `shepherd bag recover {copy}` to keep'
    whole = last.read_bytes()
    for damage in (
        last.unlink,
        lambda: last.write_bytes(b''),
        lambda: last.write_bytes(whole[:99]),
    ):
        damage()
        with pytest.raises(BagError, match=advice):
            open_bag(copy)
    assert recover(copy).messages == open_bag(bag).count - Storage(bag / last.name).count


def test_a_flipped_bit_in_a_chunk_is_found(bag: Path, tmp_path: Path) -> None:
    data = bytearray((bag / 'bag_0.mcap').read_bytes())
    place = data.index(b'shepherd_0\0')  # in a message
    data[place] ^= 4
    (tmp_path / 'bad.mcap').write_bytes(data)
    with pytest.raises(BagError, match='a chunk whose checksum is wrong at byte'):
        rows(tmp_path / 'bad.mcap')


def test_a_flipped_bit_in_the_summary_is_found(bag: Path, tmp_path: Path) -> None:
    data = bytearray((bag / 'bag_0.mcap').read_bytes())
    data[-600] ^= 1
    (tmp_path / 'bad.mcap').write_bytes(data)
    with pytest.raises(BagError, match='a summary whose checksum is wrong'):
        open_bag(tmp_path / 'bad.mcap')


def test_memory_does_not_grow_with_the_bag(tmp_path: Path) -> None:
    text = cdr(make('String', data='x' * 20_000))
    with RecordingWriter(tmp_path / 'bag', compression='zstd') as writer:
        writer.add_topic('/t', 'std_msgs/msg/String')
        for k in range(2000):  # 40 MB
            writer.write('/t', text, k, k)
    tracemalloc.start()
    assert sum(1 for _ in open_bag(tmp_path / 'bag').messages()) == 2000
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4e6
