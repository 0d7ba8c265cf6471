"""Bags in SQLite, of ROS 1 or packed as whole files, as the library rosbags reads them."""

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

STORE = get_typestore(Stores.ROS2_JAZZY)  # for bags that do not tell of their types


@dataclass(frozen=True)
class OtherFiles:
    """What Bag asks of a storage, for all files together; times in ns, size [bytes]."""

    path: Path
    size: int
    count: int
    start_ns: int
    end_ns: int
    compressions: set[str]
    metadata: None = None


class OtherBag(Bag):
    """A bag whose messages come as CDR, as ROS 2 has them, whatever they are in its files."""

    def __init__(self, path: Path, metadata: Metadata | None) -> None:
        """Read what is in the bag; raises BagError."""
        super().__init__(path, [], metadata)
        self.storage = metadata.storage if metadata else path.suffix.removeprefix('.')
        found = [path / Path(file.path).name for file in metadata.files] if metadata else [path]
        with self._reading() as reader:
            for connection in reader.connections:
                self._add(reader, connection)
            self.topics = dict(sorted(self.topics.items()))
            times = (reader.start_time, reader.end_time - 1) if reader.message_count else (0, 0)
            packed = {metadata.compression_format} if metadata else set()
            size = sum(file.stat().st_size for file in found)
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
            chosen = [c for c in reader.connections if topics is None or c.topic in topics]
            pack = {c.msgtype: self._packer(reader, c.msgtype) for c in chosen}
            rows = reader.messages(chosen, start_ns, end_ns) if chosen else ()
            for connection, ns, data in rows:
                self.on_time(ns)
                content = bytes(pack[connection.msgtype](data))
                yield BagMessage(connection.topic, connection.msgtype, ns, ns, content)

    @contextmanager
    def _reading(self) -> Iterator[AnyReader]:
        """Lend an open reader; whatever rosbags says of the bag becomes a BagError."""
        try:
            with AnyReader([self.path], default_typestore=STORE) as reader:
                yield reader
        except BagError:
            raise
        except Exception as error:
            what = f'it cannot be read ({type(error).__name__}: {line_of(error)})'
            raise BagError(self.path, what, 'use `ros2 bag convert`') from error

    def _packer(self, reader: AnyReader, kind: str) -> Callable[[bytes], Any]:
        """Return what makes CDR of the bytes of a message."""
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
        before = self.topics.get(connection.topic, TopicInfo(connection.topic, kind))
        count = before.count + connection.msgcount
        self.topics[connection.topic] = replace(before, count=count, qos=before.qos + qos)


def _with_types_of(reader: AnyReader) -> Any:
    """Return the types of Jazzy and those that only the bag has."""
    types, store = reader.typestore.fielddefs, get_typestore(Stores.ROS2_JAZZY)
    store.register({name: types[name] for name in types.keys() - store.fielddefs.keys()})
    return store


def _qos(profile: Any) -> Qos:
    """Return a profile of rosbags in rosbag2's words."""
    values = profile._asdict()
    words = {name: value.name.lower() for name, value in values.items() if hasattr(value, 'name')}
    times = {name: tuple(value) for name, value in values.items() if isinstance(value, tuple)}
    return Qos(**(values | words | times))
