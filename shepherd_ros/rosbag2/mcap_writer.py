"""
One MCAP file that is being written, readable on the disk after every chunk.

Records are those of the library mcap. Its Writer is not used, as it cannot do three things that a
recorder has to do: end a chunk early (flush), so that a crash costs a second at most; forget a
record of which the disk took only a part, and cut the file there; and then still end the file
with a summary that counts what is kept. Its counts and offsets are private and run ahead of the
disk, so that after an OSError its finish() names chunks that are not there.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
from io import FileIO
import os
from pathlib import Path
import struct
import zlib

from lz4 import frame as lz4  # type: ignore[import-untyped]
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from shepherd_ros import __version__
from shepherd_ros.rosbag2.records import MAGIC, MESSAGE, PREFIX
import zstandard

PACKERS: dict[str, Callable[[bytes], bytes]] = {
    'none': bytes,
    'lz4': lz4.compress,
    'zstd': lambda data: zstandard.ZstdCompressor().compress(data),
}


def serialize(*records: McapRecord) -> bytes:
    """Return records as the bytes of a file."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


class McapFile:
    """
    Writes messages in chunks.

    The file is not buffered, and a chunk is written at once with its indexes: a killed process
    loses the current chunk and no more. Any method may raise OSError.
    """

    def __init__(self, path: Path, compression: str, chunk_size: int) -> None:
        """Create the file, which must not exist; chunk_size [bytes] before compression."""
        self.path, self.chunk_size = path, chunk_size
        self.compression = '' if compression == 'none' else compression
        self._pack = PACKERS[compression]
        self.schemas: list[Schema] = []
        self.channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []  # on the disk
        self._counts: list[dict[int, int]] = []  # messages of each chunk, by channel
        self._metadata: list[MetadataIndex] = []
        self._size = 0  # [bytes] that a reader can rely on
        self._new_chunk()
        self._file = FileIO(path, 'xb')
        try:
            self._append(MAGIC + serialize(Header('ros2', f'shepherd_ros {__version__}')))
        except OSError:
            self._file.close()
            path.unlink()
            raise

    @property
    def size(self) -> int:
        """Return the size [bytes] with the current chunk."""
        return self._size + len(self._data)

    @property
    def start_ns(self) -> int:
        """Return the first log time on the disk, 0 without messages."""
        return min((chunk.message_start_time for chunk in self._chunks), default=0)

    @property
    def end_ns(self) -> int:
        """Return the last log time on the disk, 0 without messages."""
        return max((chunk.message_end_time for chunk in self._chunks), default=0)

    def counts(self) -> Counter[int]:
        """Return the number of messages on the disk, by channel."""
        total: Counter[int] = Counter()
        for tally in self._counts:
            total.update(tally)
        return total

    def _new_chunk(self) -> None:
        self._data = bytearray()
        self._index: defaultdict[int, list[int]] = defaultdict(list)  # log time, offset, ...
        self._first, self._last = 2**64 - 1, 0

    def _append(self, data: bytes) -> None:
        """Write all of data, or raise OSError with the size unchanged."""
        remaining = memoryview(data)
        while remaining:
            remaining = remaining[self._file.write(remaining) or 0 :]
        self._size += len(data)

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Write a schema, unless the file has it; return its id."""
        for schema in self.schemas:
            if (schema.name, schema.encoding, schema.data) == (name, encoding, data):
                return schema.id
        schema = Schema(id=len(self.schemas) + 1, name=name, encoding=encoding, data=data)
        self._append(serialize(schema))
        self.schemas.append(schema)
        return schema.id

    def add_channel(self, topic: str, encoding: str, schema: int, values: dict[str, str]) -> int:
        """Write a channel; return its id."""
        channel = Channel(len(self.channels) + 1, topic, encoding, values, schema)
        self._append(serialize(channel))
        self.channels.append(channel)
        return channel.id

    def add_message(self, channel: int, log_ns: int, publish_ns: int, data: bytes) -> None:
        """Add a message to the current chunk, and write the chunk once it is large enough."""
        self._index[channel] += log_ns, len(self._data)
        self._data += PREFIX.pack(Opcode.MESSAGE, MESSAGE.size + len(data))
        self._data += MESSAGE.pack(channel, 0, log_ns, publish_ns)
        self._data += data
        self._first, self._last = min(self._first, log_ns), max(self._last, log_ns)
        if len(self._data) >= self.chunk_size:
            self.end_chunk()

    def end_chunk(self) -> None:
        """Write the current chunk to the disk, if it has messages."""
        if not self._data:
            return
        data = bytes(self._data)
        chunk = Chunk(
            compression=self.compression,
            data=self._pack(data),
            message_start_time=self._first,
            message_end_time=self._last,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        record = serialize(chunk)
        indexes, offsets = bytearray(), {}
        for channel, flat in self._index.items():
            offsets[channel] = self._size + len(record) + len(indexes)
            length = 8 * len(flat)
            indexes += PREFIX.pack(Opcode.MESSAGE_INDEX, 6 + length)
            indexes += struct.pack(f'<HI{len(flat)}Q', channel, length, *flat)
        index = ChunkIndex(
            chunk_start_offset=self._size,
            chunk_length=len(record),
            compression=self.compression,
            compressed_size=len(chunk.data),
            message_start_time=self._first,
            message_end_time=self._last,
            message_index_length=len(indexes),
            message_index_offsets=offsets,
            uncompressed_size=len(data),
        )
        self._append(record + bytes(indexes))
        self._chunks.append(index)
        self._counts.append({channel: len(flat) // 2 for channel, flat in self._index.items()})
        self._new_chunk()

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record after all messages so far."""
        self.end_chunk()
        record = serialize(Metadata(name=name, metadata=values))
        index = MetadataIndex(offset=self._size, length=len(record), name=name)
        self._append(record)
        self._metadata.append(index)

    def finish(self) -> None:
        """Write summary and footer, flush to the disk and close; the file is complete then."""
        self.end_chunk()
        size = self._size
        try:
            self._append(self._footer_section())
            os.fsync(self._file.fileno())
        except OSError:
            self._size = size
            raise
        self._file.close()

    def cut(self, last_chunk: bool = False) -> None:
        """Drop the current chunk and unfinished records; last_chunk: the last chunk too."""
        self._new_chunk()
        if last_chunk and self._chunks:
            self._size = self._chunks.pop().chunk_start_offset
            self._counts.pop()
            self._metadata = [index for index in self._metadata if index.offset < self._size]
        self._file.truncate(self._size)
        self._file.seek(self._size)

    def abandon(self) -> None:
        """Close the file as it is."""
        self._file.close()

    def _statistics(self) -> Statistics:
        counts = self.counts()
        return Statistics(
            attachment_count=0,
            channel_count=len(self.channels),
            channel_message_counts=dict(counts),
            chunk_count=len(self._chunks),
            message_count=sum(counts.values()),
            message_end_time=self.end_ns,
            message_start_time=self.start_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self.schemas),
        )

    def _footer_section(self) -> bytes:
        """Return everything from the end of the data to the end of the file."""
        end = serialize(DataEnd(data_section_crc=0))
        start = self._size + len(end)
        summary, offsets = b'', b''
        for records in (
            self.schemas, self.channels, [self._statistics()], self._chunks, self._metadata,
        ):  # fmt: skip
            section = serialize(*records)
            if section:
                offset = SummaryOffset(section[0], start + len(summary), len(section))
                offsets += serialize(offset)
                summary += section
        offsets_record = struct.pack('<QQ', start, start + len(summary))
        crc = zlib.crc32(summary + offsets + PREFIX.pack(Opcode.FOOTER, 20) + offsets_record)
        return (
            end + summary + offsets + serialize(Footer(start, start + len(summary), crc)) + MAGIC
        )
