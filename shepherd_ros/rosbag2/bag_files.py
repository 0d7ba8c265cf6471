"""The files of a bag that is being written, and their rescue when the disk is full."""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from dataclasses import replace
import os
from pathlib import Path

from shepherd_ros.rosbag2.mcap_writer import McapFile
from shepherd_ros.rosbag2.metadata import FILE, FileInfo, Metadata, TopicInfo
from shepherd_ros.rosbag2.qos import qos_yaml


def write_atomically(path: Path, text: str) -> None:
    """Write a file with all of its text or not at all; raises OSError."""
    temporary = path.with_name(f'.{path.name}.part')
    try:
        with temporary.open('w', encoding='utf-8') as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Flush the entries of a folder to the disk; raises OSError."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


class BagFiles:
    """
    MCAP files in one folder, one after another, and metadata.yaml when all are done.

    Any method may raise OSError; rescue() is for after that.
    """

    def __init__(
        self,
        folder: Path,
        compression: str,
        chunk_size: int,
        custom_data: dict[str, str],
        distro: str,
    ) -> None:
        """Create the folder and the first file in it; custom_data may change until the end."""
        self.folder, self.compression, self.chunk_size = folder, compression, chunk_size
        self.custom_data, self.distro = custom_data, distro
        self.topics: dict[str, TopicInfo] = {}
        self.first_ns: int | None = None  # log time in the file being written
        self.schemas: dict[str, tuple[str, bytes]] = {}  # by topic
        self._channels: dict[str, int] = {}  # by topic, in the file being written
        self._finished: list[FileInfo] = []
        self._counts: Counter[str] = Counter()  # in finished files
        self._file: McapFile | None = None
        self._header_bytes = 0  # [bytes] of the file without any message
        folder.mkdir(parents=True)
        try:
            self._begin()
        except OSError:
            for path in folder.iterdir():
                path.unlink()
            folder.rmdir()
            raise

    @property
    def file(self) -> McapFile:
        """Return the file being written."""
        assert self._file is not None
        return self._file

    @property
    def written(self) -> int:
        """Return the bytes of messages in the file being written, before compression."""
        return self.file.size - self._header_bytes

    @property
    def count(self) -> int:
        """Return the number of messages in finished files."""
        return sum(f.count for f in self._finished)

    def add_topic(self, topic: TopicInfo, encoding: str, text: bytes) -> None:
        """Add a topic with the schema of its type."""
        self.topics[topic.name], self.schemas[topic.name] = topic, (encoding, text)
        self._register(topic.name)

    def add_message(self, topic: str, log_ns: int, publish_ns: int, data: bytes) -> None:
        """Write a message."""
        self.first_ns = log_ns if self.first_ns is None else min(self.first_ns, log_ns)
        self.file.add_message(self._channels[topic], log_ns, publish_ns, data)

    def split(self) -> None:
        """Finish the file and begin a new one."""
        self._finish()
        self._begin()

    def close(self) -> None:
        """Finish the last file and write metadata.yaml."""
        if self._file is not None:
            self._finish()
        write_atomically(self.folder / FILE, self.metadata().document())

    def rescue(self) -> None:
        """Finish the bag as it is on the disk, in the space that unfinished records free."""
        if self._file is not None:
            self._rescue(self._file)
        with suppress(OSError):
            write_atomically(self.folder / FILE, self.metadata().document())

    def metadata(self) -> Metadata:
        """Return the metadata of the bag as it is on the disk."""
        files, counts = list(self._finished), Counter(self._counts)
        if self._file is not None:
            files.append(_file_info(self._file))
            counts.update(_by_topic(self._file))
        topics = tuple(replace(t, count=counts[t.name]) for t in self.topics.values())
        return Metadata(topics, tuple(files), dict(self.custom_data), distro=self.distro)

    def _begin(self) -> None:
        name = self.folder.resolve().name.lstrip('.')  # hidden while it is being written
        path = self.folder / f'{name}_{len(self._finished)}.mcap'
        self._file = McapFile(path, self.compression, self.chunk_size)
        self._channels, self.first_ns = {}, None
        self._add_metadata()
        for name in self.topics:
            self._register(name)
        self._header_bytes = self._file.size

    def _register(self, name: str) -> None:
        topic = self.topics[name]
        schema = self.file.add_schema(topic.type, *self.schemas[name]) if topic.type else 0
        values = {'offered_qos_profiles': qos_yaml(topic.qos), 'topic_type_hash': topic.type_hash}
        self._channels[name] = self.file.add_channel(name, topic.serialization, schema, values)

    def _finish(self) -> None:
        self.file.end_chunk()
        self._add_metadata()
        self.file.finish()
        self._count_finished()

    def _rescue(self, file: McapFile) -> None:
        for last_chunk in (False, True):
            with suppress(OSError):
                file.cut(last_chunk)
                self._add_metadata()
                file.finish()
                break
        else:
            with suppress(OSError):
                file.abandon()
        self._count_finished()

    def _count_finished(self) -> None:
        """Count a file as done."""
        self._finished.append(_file_info(self.file))
        self._counts.update(_by_topic(self.file))
        self._file = None

    def _add_metadata(self) -> None:
        self.file.add_metadata('rosbag2', {'serialized_metadata': self.metadata().to_yaml()})


def _by_topic(file: McapFile) -> dict[str, int]:
    """Return the number of messages on the disk, by topic."""
    counts = file.counts()
    return {channel.topic: counts[channel.id] for channel in file.channels}


def _file_info(file: McapFile) -> FileInfo:
    count = sum(file.counts().values())
    if not count:
        return FileInfo(file.path.name)
    return FileInfo(file.path.name, file.start_ns, file.end_ns - file.start_ns, count)
