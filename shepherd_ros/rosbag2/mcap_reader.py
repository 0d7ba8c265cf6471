"""Storage of a whole MCAP file: the summary at its end, and its chunks one at a time."""

from __future__ import annotations

from collections import Counter
from functools import cached_property
from pathlib import Path
import struct
from typing import BinaryIO, NamedTuple
import zlib

from mcap.opcode import Opcode
from mcap.records import ChunkIndex, MetadataIndex, Statistics
from shepherd_ros.rosbag2.errors import BagError, DamageError, RECOVER_HINT, unreadable
from shepherd_ros.rosbag2.mcap_walk import Definitions
from shepherd_ros.rosbag2.metadata import Metadata
from shepherd_ros.rosbag2.records import (
    check_magic,
    contents,
    FOOTER_SIZE,
    MAGIC,
    Message,
    parse,
    PREFIX,
    read_at,
    read_record,
    record_at,
    unpack,
    walk,
)

RUN_BYTES = 1 << 20  # [bytes] of messages outside chunks that are read at once
NO_END = 'it has no end: the recording was cut off'


class ChunkRef(NamedTuple):
    """Position of messages in a file: a chunk, or a run outside chunks; times in ns."""

    start_ns: int
    end_ns: int
    offset: int
    length: int  # [bytes] with the head of the record
    channels: frozenset[int] | None  # with messages in it, None if not known
    packed: bool  # a chunk


class Storage(Definitions):
    """
    The topics, counts and chunks of one MCAP file.

    The file is open only while something is read, and at most one chunk is in memory.
    """

    def __init__(self, path: Path, bag: Path | None = None) -> None:
        """Read the summary at the end of the file, or the whole file if it is not complete."""
        super().__init__(path)
        self.fix = RECOVER_HINT.replace('{path}', str(bag or path))
        self.counts: Counter[int] = Counter()  # messages by channel
        self.start_ns = self.end_ns = 0
        self.chunks: list[ChunkRef] = []
        self._metadata_indexes: list[MetadataIndex] = []
        try:
            with path.open('rb') as file:
                self._open(file)
        except DamageError as error:
            raise BagError(path, str(error), self.fix) from error
        except OSError as error:
            raise unreadable(path, error) from error

    @property
    def count(self) -> int:
        """Return the number of messages in the file."""
        return sum(self.counts.values())

    @cached_property
    def metadata(self) -> Metadata | None:
        """Return the metadata of the bag in the file, None without any; raises BagError."""
        return Metadata.from_yaml(self.text, self.path) if self.text else None

    def read(self, chunk: ChunkRef) -> list[Message]:
        """Return the messages of a chunk in the order of their log times; raises BagError."""
        try:
            with self.path.open('rb') as file:
                items = contents(self._data(file, chunk), chunk.offset)
                messages = [item for item in items if isinstance(item, Message)]
            for message in messages:
                if not chunk.start_ns <= message.log_ns <= chunk.end_ns:
                    raise DamageError(chunk.offset, 'a message outside the time of its chunk')
                if message.channel not in self.channels:
                    raise DamageError(chunk.offset, f'unknown channel {message.channel}')
        except DamageError as error:
            raise BagError(self.path, str(error), self.fix) from error
        except OSError as error:
            raise unreadable(self.path, error) from error
        messages.sort(key=lambda message: message.log_ns)
        return messages

    def _data(self, file: BinaryIO, chunk: ChunkRef) -> bytes:
        if not chunk.packed:
            return read_at(file, chunk.offset, chunk.length)
        record = record_at(file, chunk.offset, self.size)
        if record.opcode != Opcode.CHUNK or record.end - record.offset != chunk.length:
            raise DamageError(chunk.offset, 'the index names a chunk that is not there')
        return unpack(read_record(file, record), record.offset)

    # ---- opening ----

    def _open(self, file: BinaryIO) -> None:
        self.size = check_magic(file, self.path)
        footer, summary_start, crc = self._footer(file)
        whole = bool(summary_start) and self._read_summary(file, summary_start, footer, crc)
        if not whole or (self.count and not self.chunks) or not self.channels or self._untyped():
            self._scan(file, summary_start or footer)
        with_messages = {channel for channel, count in self.counts.items() if count}
        unknown = with_messages - (self.channels.keys() - self._untyped())
        if unknown:
            raise DamageError(0, f'messages of unknown channels {sorted(unknown)[:5]}')
        if self._metadata_indexes:
            newest = max(self._metadata_indexes, key=lambda index: index.offset)
            self.take(file, record_at(file, newest.offset, self.size))

    def _footer(self, file: BinaryIO) -> tuple[int, int, int]:
        """Return the offsets of the footer and of the summary (0: none), and its CRC."""
        start = self.size - FOOTER_SIZE
        if start < len(MAGIC):
            raise BagError(self.path, NO_END, self.fix)
        data = read_at(file, start, FOOTER_SIZE)
        if data[-len(MAGIC) :] != MAGIC or PREFIX.unpack_from(data) != (Opcode.FOOTER, 20):
            raise BagError(self.path, NO_END, self.fix)
        summary_start, offsets_start, crc = struct.unpack_from('<QQI', data, PREFIX.size)
        if summary_start and not len(MAGIC) <= summary_start <= (offsets_start or start) <= start:
            raise DamageError(start, f'a summary at {summary_start}')
        return start, summary_start, crc

    def _read_summary(self, file: BinaryIO, start: int, end: int, crc: int) -> bool:
        """Read the summary; return whether it counts the messages and has all chunks."""
        chunk_count = -1
        # the checksum includes the footer up to itself
        data = read_at(file, start, end - start + PREFIX.size + 16)
        if crc and zlib.crc32(data) != crc:
            raise DamageError(start, 'a summary whose checksum is wrong')
        for record in walk(file, start, end):
            body = record.body - start
            item = parse(record.opcode, data[body : body + record.length], record.offset)
            if isinstance(item, Statistics):
                chunk_count = item.chunk_count
                self.counts.update(item.channel_message_counts)
                self.start_ns, self.end_ns = item.message_start_time, item.message_end_time
            elif isinstance(item, ChunkIndex):
                self._add_index(item)
            elif isinstance(item, MetadataIndex) and item.name == 'rosbag2':
                self._metadata_indexes.append(item)
            else:
                self.define(item)
        return chunk_count == len(self.chunks)

    def _add_index(self, index: ChunkIndex) -> None:
        self.compressions.add(index.compression)
        channels = frozenset(index.message_index_offsets) or None
        times = index.message_start_time, index.message_end_time
        if index.chunk_start_offset + index.chunk_length > self.size:
            raise DamageError(
                index.chunk_start_offset, 'the index names a chunk that is not there'
            )
        position = index.chunk_start_offset, index.chunk_length
        self.chunks.append(ChunkRef(*times, *position, channels, packed=True))

    def _untyped(self) -> set[int]:
        """Return the channels whose schema is missing."""
        return {
            channel.id
            for channel in self.channels.values()
            if channel.schema_id and channel.schema_id not in self.schemas
        }

    def _scan(self, file: BinaryIO, end: int) -> None:
        """Read the whole file for counts and chunks, which the summary lacks."""
        self.chunks, self.counts = [], Counter()
        for record, messages in self.walk(file, end):
            if not messages:
                continue
            by_channel = Counter(message.channel for message in messages)
            self.counts.update(by_channel)
            times = [message.log_ns for message in messages]
            packed = record.opcode == Opcode.CHUNK
            item = ChunkRef(
                min(times), max(times), record.offset, record.end - record.offset,
                frozenset(by_channel), packed,
            )  # fmt: skip
            last = self.chunks[-1] if self.chunks else item
            if packed or last is item or last.packed or record.end - last.offset > RUN_BYTES:
                self.chunks.append(item)
            else:
                self.chunks[-1] = _joined(last, item)
        self.start_ns = min((ref.start_ns for ref in self.chunks), default=0)
        self.end_ns = max((ref.end_ns for ref in self.chunks), default=0)


def _joined(run: ChunkRef, ref: ChunkRef) -> ChunkRef:
    """Return a run of messages with one more appended."""
    times = min(run.start_ns, ref.start_ns), max(run.end_ns, ref.end_ns)
    length = ref.offset + ref.length - run.offset
    channels = (run.channels or frozenset()) | (ref.channels or frozenset())
    return ChunkRef(*times, run.offset, length, channels, packed=False)
