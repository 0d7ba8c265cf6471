"""Walk over the records of one MCAP file, for whole files and damaged ones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema
from shepherd_ros.rosbag2.errors import DamageError
from shepherd_ros.rosbag2.records import (
    contents,
    DEFINITIONS,
    MAGIC,
    Message,
    read_at,
    read_record,
    record_at,
    RecordRef,
    unpack,
)


class Definitions:
    """Schemas, channels and metadata of one MCAP file, filled while its records are read."""

    def __init__(self, path: Path) -> None:
        """Start with nothing defined."""
        self.path = path
        self.size = 0  # [bytes]
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.compressions: set[str] = set()
        self.text = ''  # of the last record named rosbag2

    def define(self, item: Any) -> None:
        """Add a schema, a channel or a metadata record; the first of an id counts."""
        if isinstance(item, Schema):
            self.schemas.setdefault(item.id, item)
        elif isinstance(item, Channel):
            self.channels.setdefault(item.id, item)
        elif isinstance(item, Metadata) and item.name == 'rosbag2':
            self.text = item.metadata.get('serialized_metadata') or self.text

    def take(self, file: BinaryIO, record: RecordRef) -> list[Message]:
        """Add the definitions in a record, return its messages; raises DamageError."""
        if record.opcode == Opcode.CHUNK:
            chunk = read_record(file, record)
            self.compressions.add(chunk.compression)
            data = unpack(chunk, record.offset)
        elif record.opcode == Opcode.MESSAGE or record.opcode in DEFINITIONS:
            data = read_at(file, record.offset, record.end - record.offset)
        else:
            return []
        return self.messages_in(contents(data, record.offset))

    def messages_in(self, items: Iterator[Any]) -> list[Message]:
        """Return the messages among the contents of a chunk, and define the other records."""
        messages = []
        for item in items:
            if isinstance(item, Message):
                messages.append(item)
            else:
                self.define(item)
        return messages

    def walk(self, file: BinaryIO, end: int) -> Iterator[tuple[RecordRef, list[Message]]]:
        """Yield each record before `end` and before the end of the data, with its messages."""
        offset = len(MAGIC)
        while offset < end:
            try:
                record = record_at(file, offset, end)
                if record.opcode == Opcode.DATA_END and record.length >= 4:
                    return
                messages = self.take(file, record)
            except DamageError as error:
                record, messages = self.damaged(file, offset, error)
            yield record, messages
            offset = record.end

    def damaged(
        self, file: BinaryIO, offset: int, error: DamageError
    ) -> tuple[RecordRef, list[Message]]:
        """Return a record in place of the damage at an offset, and its messages; or raise."""
        raise error
