"""Reads what can be read of a damaged MCAP file: every chunk that is whole, and the torn end."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
import re
import struct
from typing import BinaryIO, TypeVar

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema
from shepherd_ros.rosbag2.errors import DamageError
from shepherd_ros.rosbag2.records import (
    check_magic,
    CHUNK,
    contents,
    FOOTER_SIZE,
    LARGEST,
    MAGIC,
    MESSAGE,
    Message,
    PREFIX,
    read_at,
    read_chunk,
    read_record,
    Record,
    record_at,
    take_messages,
    unpack,
    walk,
)

T = TypeVar('T')
DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)
WINDOW = 1 << 20  # [bytes] that are searched at once
# the head of a chunk below 4 GiB: kind, length, two times, size, checksum, name of its packing
_CHUNK = re.compile(rb'\x06.{4}\0{4}.{28}(?:\0{4}|\x03\0{3}lz4|\x04\0{3}zstd)', re.DOTALL)
_OVERLAP = 64  # [bytes] more than such a head has


class Salvage:
    """
    What is left of one file.

    Iterating yields messages in the order of the file; schemas, channels and custom are filled
    meanwhile, those that the end of the file repeats at once. A chunk whose checksum is wrong is
    lost as a whole, as nobody knows which of its messages is.
    """

    def __init__(self, path: Path) -> None:
        """Look at both ends of the file; raises BagError if it is empty or no MCAP file."""
        self.path = path
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.text = ''  # of the last record named rosbag2
        self.lost_bytes = 0
        self.lost_chunks = 0  # at least so many
        with path.open('rb') as file:
            self.size = check_magic(file, path)
            with suppress(DamageError):
                self._read_front(file)
            with suppress(DamageError):
                self._read_summary(file)

    def __iter__(self) -> Iterator[Message]:
        """Yield the messages whose channels are known."""
        with self.path.open('rb') as file:
            offset = len(MAGIC)
            self.lost_bytes = self.lost_chunks = 0
            while offset < self.size:
                try:
                    record = record_at(file, offset, self.size)
                    if record.opcode == Opcode.DATA_END and record.length == 4:
                        return
                    messages = self._read(file, record)
                    offset = record.end
                except DamageError:
                    messages, offset = self._skip(file, offset)
                for message in messages:
                    if message.channel in self.channels:
                        yield message
                    else:
                        self.lost_bytes += len(message.data)

    def _read(self, file: BinaryIO, record: Record) -> list[Message]:
        """Return the messages of a record; raises DamageError."""
        if record.opcode == Opcode.CHUNK:
            data = unpack(read_chunk(file, record), record.offset)
            return take_messages(contents(data, record.offset), self._define)
        if record.opcode == Opcode.MESSAGE:
            raw = read_at(file, record.offset, record.end - record.offset)
            return take_messages(contents(raw, record.offset), self._define)
        if record.opcode in DEFINITIONS:
            try:
                self._define(read_record(file, record))
            except DamageError:
                self.lost_bytes += record.length
        elif record.opcode == Opcode.MESSAGE_INDEX:
            _, length = struct.unpack('<HI', read_at(file, record.body, 6))
            if length != record.length - 6:
                raise DamageError(record.offset, 'a damaged index')
        elif record.opcode == Opcode.ATTACHMENT or record.opcode >= 0x80:
            self.lost_bytes += record.length
        elif record.opcode != Opcode.HEADER:
            raise DamageError(record.offset, 'a record that is not due here')
        return []

    def _define(self, item: object) -> None:
        if isinstance(item, Schema):
            self.schemas.setdefault(item.id, item)
        elif isinstance(item, Channel):
            self.channels.setdefault(item.id, item)
        elif isinstance(item, Metadata) and item.name == 'rosbag2':
            self.text = item.metadata.get('serialized_metadata', self.text)

    def _read_front(self, file: BinaryIO) -> None:
        """Take the definitions in front of the first chunk; raises DamageError."""
        for record in walk(file, len(MAGIC), self.size):
            if record.opcode in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.DATA_END):
                return
            if record.opcode in DEFINITIONS:
                self._define(read_record(file, record))

    def _read_summary(self, file: BinaryIO) -> None:
        """Take the definitions that the end of the file repeats; raises DamageError."""
        footer = self.size - FOOTER_SIZE
        data = read_at(file, max(footer, 0), FOOTER_SIZE)
        (start,) = struct.unpack_from('<Q', data, PREFIX.size)
        if not data.endswith(MAGIC) or not len(MAGIC) <= start <= footer:
            return
        for record in walk(file, start, footer):
            if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(read_record(file, record))

    # ---- damage ----

    def _skip(self, file: BinaryIO, offset: int) -> tuple[list[Message], int]:
        """Return messages of the torn end, if this is it, and where to go on."""
        found = self._next_chunk(file, offset + 1)
        if found is not None:
            self.lost_bytes += found - offset
            self.lost_chunks += 1
            return [], found
        messages, kept = self._torn(file, offset)
        self.lost_bytes += self.size - offset - kept
        self.lost_chunks += 1
        return messages, self.size

    def _next_chunk(self, file: BinaryIO, offset: int) -> int | None:
        """Return where the next chunk that is whole begins, None if there is none."""
        while offset < self.size:
            window = read_at(file, offset, min(WINDOW, self.size - offset))
            for match in _CHUNK.finditer(window):
                with suppress(DamageError):
                    record = record_at(file, offset + match.start(), self.size)
                    begin = match.end() - match.start() - PREFIX.size + 8
                    (length,) = struct.unpack('<Q', read_at(file, record.body + begin - 8, 8))
                    if length == record.length - begin:
                        unpack(read_chunk(file, record), record.offset)
                        return record.offset
            if len(window) < WINDOW:
                return None
            offset += WINDOW - _OVERLAP
        return None

    def _torn(self, file: BinaryIO, offset: int) -> tuple[list[Message], int]:
        """Return messages of a chunk that is cut off, if it is not packed, and their bytes."""
        data = read_at(file, offset, min(self.size - offset, LARGEST))
        begin = PREFIX.size + CHUNK.size + 8
        if (
            len(data) < begin
            or data[0] != Opcode.CHUNK
            or data[PREFIX.size + 28 :][:4] != bytes(4)
        ):
            return [], 0
        items = _until_damage(contents(data[begin:], offset))
        messages = take_messages(items, self._define)
        return messages, sum(PREFIX.size + MESSAGE.size + len(m.data) for m in messages)


def _until_damage(items: Iterator[T]) -> Iterator[T]:
    """Yield items as long as they can be read."""
    with suppress(DamageError):
        yield from items
