"""
Records of an MCAP file, each checked while it is read.

Every length is checked against the size of the file, so that a damaged file ends in DamageError
and never in a huge allocation. The readers of the library mcap accept lengths of up to 4 GiB,
stop at the first damage and do not report its offset.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
import struct
from typing import Any, BinaryIO, NamedTuple
import zlib

from lz4 import frame as lz4  # type: ignore[import-untyped]
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from shepherd_ros.rosbag2.errors import BagError, DamageError
import zstandard

MAGIC = b'\x89MCAP0\r\n'
PREFIX = struct.Struct('<BQ')  # opcode, length of the body [bytes]
MESSAGE = struct.Struct('<HIQQ')  # channel, sequence, log time, publish time [ns]
CHUNK_HEAD = 32  # [bytes] of a chunk: two times, size, checksum, length of a name
FOOTER_SIZE = PREFIX.size + 20 + len(MAGIC)  # [bytes] of everything that ends a file
MAX_RECORD_BYTES = 256 << 20  # [bytes] of one record, and of one chunk when unpacked
DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)
PIECE_BYTES = 1 << 20  # [bytes] that are unpacked at once
_RECORD_TYPES: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.STATISTICS: Statistics,
}


class RecordRef(NamedTuple):
    """Position of a record in a file [bytes]."""

    opcode: int
    offset: int
    length: int  # of the body

    @property
    def body(self) -> int:
        """Return the offset of the body."""
        return self.offset + PREFIX.size

    @property
    def end(self) -> int:
        """Return the offset of the next record."""
        return self.body + self.length


class Message(NamedTuple):
    """A message of a channel; times in ns."""

    channel: int
    log_ns: int
    publish_ns: int
    data: bytes


def read_at(file: BinaryIO, offset: int, length: int) -> bytes:
    """Return length bytes of a file from offset on; raises DamageError if it is shorter."""
    if length > MAX_RECORD_BYTES:
        raise DamageError(
            offset, f'a record of {length} bytes: expected at most {MAX_RECORD_BYTES}'
        )
    file.seek(offset)
    data = file.read(length)
    if len(data) != length:
        raise DamageError(offset, f'the file ends after {len(data)} of {length} bytes')
    return data


def record_at(file: BinaryIO, offset: int, end: int) -> RecordRef:
    """Return the record at offset, which has to end by `end`; raises DamageError."""
    opcode, length = PREFIX.unpack(read_at(file, offset, PREFIX.size))
    record = RecordRef(opcode, offset, length)
    if opcode == 0 or Opcode.DATA_END < opcode < 0x80:
        raise DamageError(offset, f'a record of unknown kind {opcode}')
    if record.end > end:
        raise DamageError(offset, f'a record of {length} bytes, where {end - offset} are left')
    return record


def walk(file: BinaryIO, offset: int, end: int) -> Iterator[RecordRef]:
    """Yield all records from offset to end; raises DamageError."""
    while offset < end:
        record = record_at(file, offset, end)
        yield record
        offset = record.end


class _Exact(ReadDataStream):
    """A stream that raises EndOfFile where it has fewer bytes than are read."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def parse(opcode: int, body: bytes, offset: int) -> Any:
    """Return a record of mcap.records, None for kinds that are not needed; raises DamageError."""
    kind = _RECORD_TYPES.get(opcode)
    if kind is None:
        return None
    try:
        return kind.read(_Exact(BytesIO(body)))
    except (McapError, struct.error, ValueError, OverflowError) as error:
        raise DamageError(offset, f'a damaged {kind.__name__} ({type(error).__name__})') from error


def unpack(chunk: Chunk, offset: int) -> bytes:
    """Return the records of a chunk, checked by size and CRC; raises DamageError."""
    size = chunk.uncompressed_size
    if size > MAX_RECORD_BYTES:
        raise DamageError(offset, f'a chunk of {size} bytes: expected at most {MAX_RECORD_BYTES}')
    try:
        if chunk.compression == 'zstd':
            decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_RECORD_BYTES)
            data = _read_bounded(decompressor.stream_reader(chunk.data).read, size)
        elif chunk.compression == 'lz4':
            decompressor_lz4, pending = lz4.LZ4FrameDecompressor(), [chunk.data]
            data = _read_bounded(
                lambda most: (
                    decompressor_lz4.decompress(pending.pop() if pending else b'', most)
                    if not decompressor_lz4.eof
                    else b''
                ),
                size,
            )
        elif chunk.compression == '':
            data = chunk.data
        else:
            raise DamageError(offset, f'a chunk packed with {chunk.compression[:20]!r}')
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise DamageError(offset, f'a chunk that {chunk.compression} cannot unpack') from error
    if len(data) != size:
        raise DamageError(offset, f'a chunk of {len(data)} bytes: expected {size}')
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise DamageError(offset, 'a chunk whose checksum is wrong')
    return data


def _read_bounded(read: Callable[[int], bytes], size: int) -> bytes:
    """Return the bytes of read(most) until it returns none, at most one byte more than size."""
    data = bytearray()
    while len(data) <= size:
        piece = read(min(PIECE_BYTES, size + 1 - len(data)))
        if not piece:
            break
        data += piece
    return bytes(data)


def contents(data: bytes, offset: int) -> Iterator[Message | Schema | Channel | Metadata]:
    """Yield the records in the data of a chunk that begins at offset; raises DamageError."""
    position, size = 0, len(data)
    while position < size:
        if position + PREFIX.size > size:
            raise DamageError(offset, 'a chunk that ends within a record')
        opcode, length = PREFIX.unpack_from(data, position)
        position += PREFIX.size
        end = position + length
        if end > size:
            raise DamageError(offset, 'a chunk that ends within a record')
        if opcode == Opcode.MESSAGE:
            if length < MESSAGE.size:
                raise DamageError(offset, f'a message of {length} bytes')
            channel, _, log_ns, publish_ns = MESSAGE.unpack_from(data, position)
            yield Message(channel, log_ns, publish_ns, data[position + MESSAGE.size : end])
        elif opcode in DEFINITIONS:
            yield parse(opcode, data[position:end], offset)
        elif opcode == 0 or Opcode.DATA_END < opcode < 0x80:
            raise DamageError(offset, f'a record of unknown kind {opcode} in a chunk')
        position = end


def read_record(file: BinaryIO, record: RecordRef) -> Any:
    """Return a record of a file, parsed by parse(); raises DamageError."""
    return parse(record.opcode, read_at(file, record.body, record.length), record.offset)


def check_magic(file: BinaryIO, path: Path) -> int:
    """Return the size of a file [bytes] that begins like MCAP; raises BagError."""
    size = file.seek(0, 2)
    file.seek(0)
    if size == 0:
        raise BagError(path, 'it is empty', 'there is nothing to recover: record again')
    if file.read(len(MAGIC)) != MAGIC:
        raise BagError(path, 'it is no MCAP file', 'expected a bag in the format of MCAP')
    return size
