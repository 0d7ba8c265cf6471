"""A crash, a torn disk or a flipped bit costs at most the chunk that it hits."""

from __future__ import annotations

from pathlib import Path
import random
import shutil
import struct
from typing import Any

from mcap.reader import make_reader
from mcap.writer import Writer
import pytest
from rosbag2.test_reader import mcap_of_others
from rosbag2.tiny import cdr, make, recording, Sent, tiny_bag, write
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from shepherd_ros.cli import main
from shepherd_ros.recordings.check import check_bag
from shepherd_ros.recordings.recording_writer import RecordingWriter, recover_recording
from shepherd_ros.rosbag2 import salvage
from shepherd_ros.rosbag2.diff import diff_bags
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.rosbag2.mcap_reader import ChunkRef, Storage
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.rosbag2.records import MESSAGE, PREFIX
from shepherd_ros.rosbag2.recover import recovered_folder
from shepherd_ros.rosbag2.salvage import Salvage
from shepherd_ros.rosbag2.writer import BagWriter

MESSAGES = list(recording()[0])
CHUNK = 3000  # [bytes]


@pytest.fixture(scope='module')
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bag with about ten chunks."""
    return tiny_bag(tmp_path_factory.mktemp('w') / 'bag', chunk_size=CHUNK)


def stored(folder: Path) -> list[Sent]:
    """Return the messages of a bag after every reader has opened it."""
    rows = [
        Sent(m.topic, m.type, m.data, m.log_ns, m.publish_ns) for m in open_bag(folder).messages()
    ]
    for reader in (Reader(folder), AnyReader([folder])):
        with reader:
            assert reader.message_count == len(rows)
            reference = reader.messages(reader.connections)
            assert [(c.topic, ns, bytes(d)) for c, ns, d in reference] == [
                (m.topic, m.log_ns, m.data) for m in rows
            ]
    for file in folder.glob('*.mcap'):
        with file.open('rb') as stream:
            list(make_reader(stream, validate_crcs=True).iter_messages())
    assert (folder / 'metadata.yaml').exists()
    return rows


def messages_in(folder: Path, chunks: list[ChunkRef]) -> int:
    """Return how many messages some chunks of a bag have."""
    storage = Storage(next(folder.glob('*.mcap')))
    return sum(len(storage.read(chunk)) for chunk in chunks)


def lost(rows: list[Sent]) -> int:
    """Return how many messages are missing; all others are as they were."""
    assert set(rows) <= set(MESSAGES)
    assert rows == sorted(rows, key=lambda m: m.log_ns)
    return len(MESSAGES) - len(rows)


def test_a_whole_bag_comes_out_equal(whole: Path, tmp_path: Path) -> None:
    result = recover_recording(whole, tmp_path / 'new')
    assert (result.messages, result.lost_bytes, result.lost_chunks) == (len(MESSAGES), 0, 0)
    assert stored(tmp_path / 'new') == MESSAGES
    assert diff_bags(open_bag(whole), open_bag(tmp_path / 'new'), times=True).equal
    assert open_bag(tmp_path / 'new').custom_data == open_bag(whole).custom_data
    assert open_bag(tmp_path / 'new').topics == open_bag(whole).topics
    assert check_bag(open_bag(tmp_path / 'new')).ok
    assert result.text().startswith(
        f'{tmp_path / "new"}: {len(MESSAGES)} messages kept of 1 files'
    )


@pytest.mark.parametrize('seed', range(9))
def test_a_file_that_was_cut_off_loses_what_was_cut(
    whole: Path, tmp_path: Path, seed: int
) -> None:
    data = (whole / 'bag_0.mcap').read_bytes()
    chunks = Storage(whole / 'bag_0.mcap').chunks
    size = random.Random(seed).randrange(chunks[0].offset, len(data))
    torn = tmp_path / 'torn.mcap'
    torn.write_bytes(data[:size])
    result = recover_recording(torn)
    assert torn.read_bytes() == data[:size]
    assert result.folder == tmp_path / 'torn_recovered'
    rows = stored(result.folder)
    assert rows == MESSAGES[: len(rows)]
    present = [chunk for chunk in chunks if chunk.offset + chunk.length <= size]
    torn_one = chunks[: len(present) + 1]
    assert messages_in(whole, present) <= len(rows) <= messages_in(whole, torn_one)
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith('.')] == []


@pytest.mark.parametrize('seed', range(9))
def test_a_torn_place_costs_the_chunks_that_it_touches(tmp_path: Path, seed: int) -> None:
    compression = ('none', 'zstd', 'lz4')[seed % 3]
    folder = tiny_bag(tmp_path / 'bag', chunk_size=CHUNK, compression=compression)
    path = folder / 'bag_0.mcap'
    chunks = Storage(path).chunks
    counts = {chunk: messages_in(folder, [chunk]) for chunk in chunks}
    before = path.read_bytes()
    data = bytearray(before)
    rng = random.Random(seed)
    begin = rng.randrange(chunks[0].offset, chunks[-1].offset)
    length = rng.randrange(1, 400)
    data[begin : begin + length] = bytes(length) if seed % 2 else rng.randbytes(length)
    path.write_bytes(data)
    (folder / 'metadata.yaml').unlink()
    places = {chunk: slice(chunk.offset, chunk.offset + chunk.length) for chunk in chunks}
    touched = [chunk for chunk, place in places.items() if data[place] != before[place]]
    result = recover_recording(folder)
    assert path.read_bytes() == bytes(data)
    assert lost(stored(result.folder)) == sum(counts[chunk] for chunk in touched)
    assert result.lost_chunks or not touched


def test_without_summary_the_front_tells_of_the_topics(whole: Path, tmp_path: Path) -> None:
    """A recorder that was killed leaves no metadata.yaml and no end."""
    copy = shutil.copytree(whole, tmp_path / 'copy')
    (copy / 'metadata.yaml').unlink()
    path = copy / 'bag_0.mcap'
    chunks = Storage(path).chunks
    path.write_bytes(path.read_bytes()[: chunks[-1].offset + chunks[-1].length])
    result = recover_recording(copy)
    assert stored(result.folder) == MESSAGES
    assert result.lost_bytes == 0
    # the first episode comes from its topic
    assert open_bag(result.folder).custom_data == open_bag(whole).custom_data


def test_an_uncompressed_torn_chunk_gives_its_messages(whole: Path, tmp_path: Path) -> None:
    data = (whole / 'bag_0.mcap').read_bytes()
    chunks = Storage(whole / 'bag_0.mcap').chunks
    torn = tmp_path / 'torn.mcap'
    torn.write_bytes(data[: chunks[2].offset + chunks[2].length - 1])
    assert recover_recording(torn).messages == messages_in(whole, chunks[:3]) - 1


@pytest.mark.parametrize('chunked', [True, False])
def test_files_of_the_mcap_library(tmp_path: Path, chunked: bool) -> None:
    path = tmp_path / 'theirs.mcap'
    mcap_of_others(path, MESSAGES, use_chunking=chunked, chunk_size=CHUNK)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    rows = stored(recover_recording(path).folder)
    assert rows == MESSAGES[: len(rows)]
    assert len(rows) > len(MESSAGES) // 4


def test_split_bags_stay_split_and_one_bad_file_is_told(tmp_path: Path) -> None:
    folder = tiny_bag(tmp_path / 'bag', chunk_size=CHUNK, split_bytes=9000)
    count = len(list(folder.glob('*.mcap')))
    assert count > 2
    (folder / 'bag_1.mcap').write_bytes(b'nothing of the kind')
    (folder / 'bag_2.mcap').write_bytes((folder / 'bag_2.mcap').read_bytes()[:-30])
    result = recover_recording(folder)
    assert len(list(result.folder.glob('*.mcap'))) == count - 1 == result.files
    assert len(result.refused) == 1
    assert 'bag_1.mcap: it is no MCAP file' in result.text()
    stored(result.folder)


def test_what_has_nothing_to_recover_is_refused(tmp_path: Path, whole: Path) -> None:
    (tmp_path / 'empty.mcap').write_bytes(b'')
    (tmp_path / 'text.mcap').write_text('no bag at all')
    (tmp_path / 'folder').mkdir()
    for path, what in (
        ('empty.mcap', 'it is empty; there is nothing to recover'),
        ('text.mcap', 'it is no MCAP file'),
        ('folder', r'it holds no \.mcap file'),
        ('none', 'it cannot be read .No such file'),
    ):
        with pytest.raises(BagError, match=what):
            recover_recording(tmp_path / path)
        assert not recovered_folder(tmp_path / path).exists()
    with pytest.raises(BagError, match='it exists already; choose another folder'):
        recover_recording(whole, tmp_path / 'folder')
    with pytest.raises(BagError, match='it cannot be created'):
        recover_recording(whole, tmp_path / 'text.mcap' / 'deeper')


def test_a_file_with_nothing_but_a_front_gives_an_empty_bag(whole: Path, tmp_path: Path) -> None:
    data = (whole / 'bag_0.mcap').read_bytes()
    for size in (8, 20, 200):
        (tmp_path / f'{size}.mcap').write_bytes(data[:size])
        assert stored(recover_recording(tmp_path / f'{size}.mcap').folder) == []


def test_a_last_chunk_that_was_altered_is_lost_and_a_torn_one_is_not(
    whole: Path, tmp_path: Path
) -> None:
    """All of its bytes are there, and one is another: nobody knows in which message."""
    data = bytearray((whole / 'bag_0.mcap').read_bytes())
    chunks = Storage(whole / 'bag_0.mcap').chunks
    last = chunks[-1]
    data[last.offset + last.length - 5] ^= 1
    for size in (len(data), last.offset + last.length):
        (tmp_path / f'{size}.mcap').write_bytes(data[:size])
        result = recover_recording(tmp_path / f'{size}.mcap')
        assert result.messages == messages_in(whole, chunks[:-1])
        assert stored(result.folder) == MESSAGES[: result.messages]


# ---- salvage, record by record ----


def strings(path: Path, count: int, **options: Any) -> tuple[Path, list[ChunkRef], int]:
    """Write a file with chunks of three messages; return it, its chunks and a message's bytes."""
    with RecordingWriter(path, chunk_size=1 << 20, **options) as writer:
        writer.add_topic('/t', 'std_msgs/msg/String')
        writer.add_topic('/silent', 'std_msgs/msg/Float64')
        data = cdr(make('String', data='x' * 31))
        for k in range(count):
            writer.write('/t', data, k, k)
            if k % 3 == 2:
                writer.flush()
    file = path / f'{path.name}_0.mcap'
    return file, Storage(file).chunks, PREFIX.size + MESSAGE.size + len(data)


def salvaged(path: Path, data: bytes) -> tuple[list[int], int, int]:
    """Return the log times in damaged bytes, and how many bytes and places are lost."""
    path.write_bytes(data)
    found = Salvage(path)
    times = [message.log_ns for message in found]
    return times, found.lost_bytes, found.lost_chunks


def test_wherever_a_chunk_is_cut_its_whole_messages_are_kept(tmp_path: Path) -> None:
    file, (_, last), size = strings(tmp_path / 'bag', 6)
    data, end = file.read_bytes(), last.offset + last.length
    before = end - 3 * size  # of the first message in the last chunk
    for cut in range(last.offset, end + 1):
        messages = max(cut - before, 0) // size
        lost_bytes = 0 if cut in (last.offset, end) else cut - last.offset - messages * size
        expected = list(range(3 + messages)), lost_bytes, int(cut not in (last.offset, end))
        assert salvaged(tmp_path / 'cut.mcap', data[:cut]) == expected, cut


def test_a_chunk_is_found_behind_damage_wherever_it_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for compression in ('none', 'zstd', 'lz4'):
        file, chunks, _ = strings(tmp_path / compression, 9, compression=compression)
        data = bytearray(file.read_bytes())
        data[chunks[1].offset + 9 + 33] ^= 1  # its checksum, or the name of its packing
        data[chunks[1].offset] = 0x7F
        for window in (1 << 20, *range(100, 190)):
            monkeypatch.setattr(salvage, 'SEARCH_WINDOW', window)
            times, lost_bytes, places = salvaged(tmp_path / 'bad.mcap', bytes(data))
            assert times == [0, 1, 2, 6, 7, 8], (compression, window)
            assert (lost_bytes, places) == (chunks[2].offset - chunks[1].offset, 1)


def test_what_is_between_chunks_is_read_with_suspicion(tmp_path: Path) -> None:
    file, (_, place, _), _ = strings(tmp_path / 'bag', 9)
    data, at = file.read_bytes(), place.offset

    def with_record(kind: int, body: bytes) -> tuple[list[int], int, int]:
        record = PREFIX.pack(kind, len(body)) + body
        return salvaged(tmp_path / 'more.mcap', data[:at] + record + data[at:])

    everything, first = list(range(9)), [0, 1, 2]
    assert with_record(0x0F, bytes(4)) == (first, 0, 0)  # the end of the data
    assert with_record(0x0F, bytes(3)) == (everything, 12, 1)  # it has a checksum of four bytes
    index = struct.pack('<HI', 1, 16)
    assert with_record(0x07, index + bytes(16)) == (everything, 0, 0)
    assert with_record(0x07, index + bytes(17)) == (everything, 0, 0)  # of a later version
    assert with_record(0x07, index + bytes(15)) == (everything, 9 + 6 + 15, 1)
    assert with_record(0x07, struct.pack('<HI', 1, 10) + bytes(2)) == (everything, 9 + 8, 1)
    assert with_record(0x09, b'abc') == (everything, 3, 0)  # an attachment
    assert with_record(0x80, b'abcd') == (everything, 4, 0)  # of somebody's own
    assert with_record(0x04, b'abcde') == (everything, 9 + 5, 1)  # a channel that cannot be read
    assert with_record(0x01, b'abcde') == (everything, 0, 0)  # a header
    assert with_record(0x0B, b'abcde') == (everything, 9 + 5, 1)  # statistics are not due here
    message = MESSAGE.pack(99, 0, 5, 5) + b'xyz'
    assert with_record(0x05, message) == (everything, 3, 0)  # of a channel that is not there


def test_the_end_tells_of_topics_that_a_lost_chunk_would_have_told_of(tmp_path: Path) -> None:
    path = tmp_path / 'theirs.mcap'
    mcap_of_others(path, MESSAGES, chunk_size=CHUNK)
    chunks = Storage(path).chunks
    counts = [len(Storage(path).read(chunk)) for chunk in chunks]
    data = bytearray(path.read_bytes())
    data[chunks[0].offset + chunks[0].length - 9] ^= 1
    path.write_bytes(data)
    result = recover_recording(path)
    assert (result.messages, result.lost_chunks) == (sum(counts[1:]), 1)
    assert result.lost_bytes == chunks[0].length + len(index_of(path, chunks[0]))
    assert stored(result.folder) == MESSAGES[counts[0] :]


def index_of(path: Path, chunk: ChunkRef) -> bytes:
    """Return the message indexes behind a chunk."""
    data, end = path.read_bytes(), chunk.offset + chunk.length
    begin = end
    while data[end] == 0x07:
        end += PREFIX.size + PREFIX.unpack_from(data, end)[1]
    return data[begin:end]


def test_topics_without_messages_are_kept(tmp_path: Path) -> None:
    strings(tmp_path / 'bag', 4)
    result = recover_recording(tmp_path / 'bag', tmp_path / 'new')
    assert open_bag(result.folder).topics == open_bag(tmp_path / 'bag').topics
    assert {name: topic.count for name, topic in open_bag(result.folder).topics.items()} == {
        '/t': 4, '/silent': 0,
    }  # fmt: skip
    assert (result.topics, result.files, result.whole) == ({'/t': 4}, 1, True)
    assert result.text().splitlines()[1:] == ['  /t: 4', 'lost: 0 bytes in 0 places']


def test_messages_in_other_encodings_are_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'json.mcap'
    with path.open('wb') as stream:
        writer = Writer(stream)
        writer.start('')
        schema = writer.register_schema('J', 'jsonschema', b'{}')
        for number, topic in ((schema, '/j'), (0, '/n')):
            channel = writer.register_channel(topic, 'json', number)
            writer.add_message(channel, 7, b'{"i": 0}', 7)
        writer.add_attachment(1, 1, 'map.png', 'image/png', b'png')
        writer.finish()
    assert main(['bag', 'recover', str(path)]) == 1
    assert 'not kept: 1 attachments' in capsys.readouterr().out
    new = open_bag(tmp_path / 'json_recovered')
    assert [(m.topic, m.type, m.data) for m in new.messages()] == [
        ('/j', 'J', b'{"i": 0}'), ('/n', '', b'{"i": 0}'),
    ]  # fmt: skip
    assert {topic.serialization for topic in new.topics.values()} == {'json'}
    assert new.schemas['J'] == ('jsonschema', b'{}')


def test_the_distribution_and_what_was_noted_last_stay(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bag', distro='humble') as writer:
        writer.custom_data['lost'] = '3'  # known at the end only
    for distro, path in (('humble', tmp_path / 'bag'), ('', tmp_path / 'plain.mcap')):
        if not distro:
            mcap_of_others(path, MESSAGES[:3])
        metadata = open_bag(recover_recording(path).folder).metadata
        assert metadata is not None
        assert metadata.distro == distro
        assert metadata.custom_data == ({'lost': '3'} if distro else {})


def test_two_types_on_one_topic_keep_the_first(tmp_path: Path) -> None:
    first = write(tmp_path / 'bag', MESSAGES[:20])
    other = write(tmp_path / 'b', [MESSAGES[0]._replace(topic='/flock/poses', log_ns=10**18)])
    shutil.move(other / 'b_0.mcap', first / 'bag_1.mcap')
    result = recover_recording(first)
    assert stored(result.folder) == MESSAGES[:20]
    assert result.lost_bytes == len(MESSAGES[0].data)
    assert not result.whole
    assert '1 messages: /flock/poses has type geometry_msgs/msg/PoseArray' in result.text()
    assert 'is offered as std_msgs/msg/String too; the first type is kept' in result.text()


def test_two_texts_of_one_type_on_one_topic_keep_the_first(tmp_path: Path) -> None:
    for number, text in enumerate((b'float64 data\n', b'float32 a\nfloat32 data\n')):
        with BagWriter(tmp_path / f'{number}') as writer:
            writer.add_topic('/f', 'std_msgs/msg/Float64', schema=('ros2msg', text))
            writer.write('/f', bytes(12), number, number)
    shutil.move(tmp_path / '1' / '1_0.mcap', tmp_path / '0' / '0_1.mcap')
    result = recover_recording(tmp_path / '0')
    assert (result.messages, result.whole) == (1, False)
    assert 'is offered as another std_msgs/msg/Float64 too' in result.text()
