"""Salvage of a damaged MCAP file: every whole chunk, and the readable part of a torn one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
import re
import struct
from typing import BinaryIO, TypeVar

from mcap.opcode import Opcode
from shepherd_ros.rosbag2.errors import DamageError
from shepherd_ros.rosbag2.mcap_walk import Definitions
from shepherd_ros.rosbag2.records import (
    check_magic,
    CHUNK_HEAD,
    contents,
    DEFINITIONS,
    FOOTER_SIZE,
    MAGIC,
    MAX_RECORD_BYTES,
    MESSAGE,
    Message,
    PREFIX,
    read_at,
    read_record,
    record_at,
    RecordRef,
    unpack,
    walk,
)

T = TypeVar('T')
SEARCH_WINDOW = 1 << 20  # [bytes] that are searched at once
GAP_OPCODE = 0  # opcode of a record that stands for bytes that cannot be read
# the head of a chunk below 4 GiB: kind, length, two times, size, checksum, name of its packing
_CHUNK = re.compile(rb'\x06.{4}\0{4}.{28}(?:\0{4}|\x03\0{3}lz4|\x04\0{3}zstd)', re.DOTALL)
_HEAD_BYTES = 64  # [bytes] more than such a head has


class Salvage(Definitions):
    """
    Readable part of a damaged file.

    Iterating yields messages in the order of the file; schemas, channels and text are filled
    meanwhile, those that the end of the file repeats at once. A chunk whose checksum is wrong is
    lost as a whole, as nobody knows which of its messages is.
    """

    def __init__(self, path: Path) -> None:
        """Read both ends of the file; raises BagError if it is empty or no MCAP file."""
        super().__init__(path)
        self.lost_bytes = 0
        self.lost_chunks = 0  # at least so many
        self.unsupported: Counter[str] = Counter()  # kinds of records that a bag has no place for
        with path.open('rb') as file:
            self.size = check_magic(file, path)
            with suppress(DamageError):
                for record in walk(file, len(MAGIC), self.size):
                    if record.opcode in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.DATA_END):
                        break
                    Definitions.take(self, file, record)
            with suppress(DamageError):
                self._read_summary(file)

    def __iter__(self) -> Iterator[Message]:
        """Yield the messages whose channels are known."""
        self.lost_bytes = self.lost_chunks = 0
        self.unsupported.clear()
        with self.path.open('rb') as file:
            for _, messages in self.walk(file, self.size):
                for message in messages:
                    if message.channel in self.channels:
                        yield message
                    else:
                        self.lost_bytes += len(message.data)
                        self.unsupported['messages of unknown topics'] += 1

    def take(self, file: BinaryIO, record: RecordRef) -> list[Message]:
        """Return the messages of a record; raises DamageError."""
        if record.opcode == Opcode.MESSAGE_INDEX:
            _, length = struct.unpack('<HI', read_at(file, record.body, 6))
            if length > record.length - 6:
                raise DamageError(record.offset, 'a damaged index')
        elif record.opcode == Opcode.ATTACHMENT or record.opcode >= 0x80:
            kind = 'attachments' if record.opcode == Opcode.ATTACHMENT else 'private records'
            self.unsupported[kind] += 1
            self.lost_bytes += record.length
        elif record.opcode not in (Opcode.HEADER, Opcode.CHUNK, Opcode.MESSAGE, *DEFINITIONS):
            raise DamageError(record.offset, 'a record that is not due here')
        return super().take(file, record)

    def _read_summary(self, file: BinaryIO) -> None:
        """Add the definitions that the end of the file repeats; raises DamageError."""
        footer = self.size - FOOTER_SIZE
        data = read_at(file, max(footer, 0), FOOTER_SIZE)
        (start,) = struct.unpack_from('<Q', data, PREFIX.size)
        if not data.endswith(MAGIC) or not len(MAGIC) <= start <= footer:
            return
        for record in walk(file, start, footer):
            if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                Definitions.take(self, file, record)

    # ---- damage ----

    def damaged(
        self, file: BinaryIO, offset: int, error: DamageError
    ) -> tuple[RecordRef, list[Message]]:
        """Return a record for the gap up to the next whole chunk, and messages of a torn end."""
        next_chunk = self._next_chunk(file, offset + 1)
        messages, kept_bytes = ([], 0) if next_chunk else self._torn_chunk(file, offset)
        end = next_chunk or self.size
        self.lost_bytes += end - offset - kept_bytes
        self.lost_chunks += 1
        return RecordRef(GAP_OPCODE, offset, end - offset - PREFIX.size), messages

    def _next_chunk(self, file: BinaryIO, offset: int) -> int | None:
        """Return the offset of the next whole chunk, None if there is none."""
        while offset < self.size:
            window = read_at(file, offset, min(SEARCH_WINDOW, self.size - offset))
            for match in _CHUNK.finditer(window):
                with suppress(DamageError):
                    record = record_at(file, offset + match.start(), self.size)
                    head = match.end() - match.start() - PREFIX.size + 8
                    (length,) = struct.unpack('<Q', read_at(file, record.body + head - 8, 8))
                    if length == record.length - head:
                        unpack(read_record(file, record), record.offset)
                        return record.offset
            if len(window) < SEARCH_WINDOW:
                return None
            offset += SEARCH_WINDOW - _HEAD_BYTES
        return None

    def _torn_chunk(self, file: BinaryIO, offset: int) -> tuple[list[Message], int]:
        """Return messages of an uncompressed chunk cut off by the end of file, and their bytes."""
        data = read_at(file, offset, min(self.size - offset, MAX_RECORD_BYTES))
        head = PREFIX.size + CHUNK_HEAD + 8
        if len(data) < head or data[0] != Opcode.CHUNK or data[head - 12 : head - 8] != bytes(4):
            return [], 0
        (length,) = struct.unpack_from('<Q', data, 1)
        if offset + PREFIX.size + length <= self.size:
            return [], 0  # it is all there, but altered
        messages = self.messages_in(_until_damage(contents(data[head:], offset)))
        return messages, sum(PREFIX.size + MESSAGE.size + len(m.data) for m in messages)


def _until_damage(items: Iterator[T]) -> Iterator[T]:
    """Yield items until DamageError."""
    with suppress(DamageError):
        yield from items
