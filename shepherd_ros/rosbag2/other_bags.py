"""Bags in SQLite, of ROS 1 or compressed as whole files, read by the library rosbags."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rosbags.convert.converter import generate_message_converter
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores
from shepherd_ros.rosbag2.bag import Bag, BagMessage
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.rosbag2.metadata import Metadata, TopicInfo
from shepherd_ros.rosbag2.qos import line_of, Qos

STORE = get_typestore(Stores.ROS2_JAZZY)  # for bags without definitions of their types


@dataclass(frozen=True)
class OtherFiles:
    """The part of Storage that Bag uses, for all files together; times in ns, size [bytes]."""

    path: Path
    size: int
    count: int
    start_ns: int
    end_ns: int
    compressions: set[str]
    metadata: None = None


class OtherBag(Bag):
    """A bag that yields its messages as CDR of ROS 2, whatever the format of its files."""

    def __init__(self, path: Path, metadata: Metadata | None) -> None:
        """Read topics and counts of the bag; raises BagError."""
        super().__init__(path, [], metadata)
        self.storage = metadata.storage if metadata else path.suffix.removeprefix('.')
        paths = [path / Path(file.path).name for file in metadata.files] if metadata else [path]
        with self._reading() as reader:
            for connection in reader.connections:
                self._add(reader, connection)
            self.topics = dict(sorted(self.topics.items()))
            times = (reader.start_time, reader.end_time - 1) if reader.message_count else (0, 0)
            packed = {metadata.compression_format} if metadata else set()
            size = sum(file.stat().st_size for file in paths)
            files = OtherFiles(path, size, reader.message_count, *times, packed)
        self.storages = [files]  # type: ignore[list-item]

    def messages(
        self,
        topics: Collection[str] | None = None,
        start_ns: int = 0,
        end_ns: int | None = None,
    ) -> Iterator[BagMessage]:
        """Yield messages in the order of their log times, those of [start_ns, end_ns) only."""
        with self._reading() as reader:
            connections = [c for c in reader.connections if topics is None or c.topic in topics]
            to_cdr = {c.msgtype: self._cdr_converter(reader, c.msgtype) for c in connections}
            messages = reader.messages(connections, start_ns, end_ns) if connections else ()
            for connection, ns, data in messages:
                self.on_time(ns)
                content = bytes(to_cdr[connection.msgtype](data))
                yield BagMessage(connection.topic, connection.msgtype, ns, ns, content)

    @contextmanager
    def _reading(self) -> Iterator[AnyReader]:
        """Yield an open reader; any error of rosbags becomes a BagError."""
        try:
            with AnyReader([self.path], default_typestore=STORE) as reader:
                yield reader
        except BagError:
            raise
        except Exception as error:
            reason = f'it cannot be read ({type(error).__name__}: {line_of(error)})'
            raise BagError(self.path, reason, 'use `ros2 bag convert`') from error

    def _cdr_converter(self, reader: AnyReader, kind: str) -> Callable[[bytes], Any]:
        """Return the function that converts the bytes of a message to CDR."""
        if reader.is2:
            return bytes
        store = _with_types_of(reader)
        return generate_message_converter(
            reader.typestore, store, kind, kind, {}, src_is2=False, dst_is2=True
        )

    def _add(self, reader: AnyReader, connection: Any) -> None:
        kind, ext = connection.msgtype, connection.ext
        store = STORE if reader.is2 else _with_types_of(reader)
        text = store.generate_msgdef(kind, 2)[0] if kind in store.fielddefs else ''
        if reader.is2 and connection.msgdef.format.name != 'NONE':
            text = connection.msgdef.data
        encoding = 'ros2idl' if connection.msgdef.format.name == 'IDL' else 'ros2msg'
        self.schemas.setdefault(kind, (encoding, text.encode()))
        self.definitions[connection.topic].add((kind, encoding, text.encode()))
        if reader.is2:
            qos = tuple(_qos(profile) for profile in ext.offered_qos_profiles)
        else:
            qos = (Qos(durability='transient_local' if ext.latching else 'volatile'),)
        known = self.topics.get(connection.topic, TopicInfo(connection.topic, kind))
        count = known.count + connection.msgcount
        self.topics[connection.topic] = replace(known, count=count, qos=known.qos + qos)


def _with_types_of(reader: AnyReader) -> Any:
    """Return a store with the types of Jazzy and those that only the bag has."""
    types, store = reader.typestore.fielddefs, get_typestore(Stores.ROS2_JAZZY)
    store.register({name: types[name] for name in types.keys() - store.fielddefs.keys()})
    return store


def _qos(profile: Any) -> Qos:
    """Return a profile of rosbags as rosbag2 writes it."""
    values = profile._asdict()
    words = {name: value.name.lower() for name, value in values.items() if hasattr(value, 'name')}
    times = {name: tuple(value) for name, value in values.items() if isinstance(value, tuple)}
    return Qos(**(values | words | times))
