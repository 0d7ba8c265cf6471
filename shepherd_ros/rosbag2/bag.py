"""A bag in MCAP: its topics, and its messages in the order of their log times."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from functools import cached_property
import heapq
from pathlib import Path
from typing import NamedTuple

from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.rosbag2.mcap_reader import Storage
from shepherd_ros.rosbag2.metadata import Metadata, STORAGE, TopicInfo
from shepherd_ros.rosbag2.qos import read_qos


class BagMessage(NamedTuple):
    """A recorded message with its log time and its publish time [ns]."""

    topic: str
    type: str
    log_ns: int
    publish_ns: int
    data: bytes  # CDR


class Bag:
    """A bag that can be read any number of times; no file stays open."""

    def __init__(self, path: Path, files: list[Path], metadata: Metadata | None) -> None:
        """Read the summaries at the ends of all files."""
        self.path, self.storage = path, STORAGE
        self.storages = [_storage(file, path, len(files)) for file in files]
        self._metadata = metadata
        self.on_time: Callable[[int], None] = lambda ns: None  # log time [ns] that is read next
        self.topics: dict[str, TopicInfo] = {}  # in the order of their names
        self.schemas: dict[str, tuple[str, bytes]] = {}  # encoding and text of a type
        # type, encoding and text of the channels of each topic: one, if all is well
        self.definitions: defaultdict[str, set[tuple[str, str, bytes]]] = defaultdict(set)
        for storage in self.storages:
            self._add_topics(storage)
        self.topics = dict(sorted(self.topics.items()))

    @property
    def count(self) -> int:
        """Return the number of messages in the bag."""
        return sum(storage.count for storage in self.storages)

    @property
    def start_ns(self) -> int:
        """Return the first log time, 0 without messages."""
        return min((s.start_ns for s in self.storages if s.count), default=0)

    @property
    def end_ns(self) -> int:
        """Return the last log time, 0 without messages."""
        return max((s.end_ns for s in self.storages if s.count), default=0)

    @cached_property
    def metadata(self) -> Metadata | None:
        """Return the metadata of metadata.yaml, or else of the last file, None without any."""
        if self._metadata is not None:
            return self._metadata
        embedded = (storage.metadata for storage in reversed(self.storages))
        return next((metadata for metadata in embedded if metadata is not None), None)

    @property
    def metadata_count(self) -> int | None:
        """Return the number of messages according to metadata.yaml, None without it."""
        metadata = self._metadata
        return None if metadata is None else sum(topic.count for topic in metadata.topics)

    @property
    def custom_data(self) -> dict[str, str]:
        """Return the custom data in the metadata."""
        return self.metadata.custom_data if self.metadata else {}

    def messages(
        self,
        topics: Collection[str] | None = None,
        start_ns: int = 0,
        end_ns: int | None = None,
    ) -> Iterator[BagMessage]:
        """
        Yield messages in the order of their log times, those of [start_ns, end_ns) only.

        topics None means all. Chunks that overlap in time are in memory together, else one at a
        time. Raises BagError where the bag is damaged.
        """
        end = 2**64 if end_ns is None else end_ns
        channels_by_file = [self._selected_channels(storage, topics) for storage in self.storages]
        chunks = sorted(
            (chunk.start_ns, number, chunk)
            for number, storage in enumerate(self.storages)
            for chunk in storage.chunks
            if chunk.end_ns >= start_ns
            and chunk.start_ns < end
            and (chunk.channels is None or not chunk.channels.isdisjoint(channels_by_file[number]))
        )
        # log time, file, place in the file, place in the chunk: no two are equal
        heap: list[tuple[int, int, int, int, BagMessage]] = []
        for start, number, chunk in chunks:
            self.on_time(start)
            while heap and heap[0][0] < start:
                yield heapq.heappop(heap)[-1]
            names = channels_by_file[number]
            for place, message in enumerate(self.storages[number].read(chunk)):
                name = names.get(message.channel)
                if name is not None and start_ns <= message.log_ns < end:
                    item = BagMessage(*name, message.log_ns, message.publish_ns, message.data)
                    heapq.heappush(heap, (message.log_ns, number, chunk.offset, place, item))
        while heap:
            yield heapq.heappop(heap)[-1]

    def _selected_channels(
        self, storage: Storage, topics: Collection[str] | None
    ) -> dict[int, tuple[str, str]]:
        """Return topic and type by channel of a file; topics None means all."""
        return {
            channel.id: (channel.topic, _type(storage, channel.schema_id))
            for channel in storage.channels.values()
            if topics is None or channel.topic in topics
        }

    def _add_topics(self, storage: Storage) -> None:
        for schema in storage.schemas.values():
            self.schemas.setdefault(schema.name, (schema.encoding, schema.data))
        for channel in storage.channels.values():
            record = storage.schemas.get(channel.schema_id)
            text = (record.name, record.encoding, record.data) if record else ('', '', b'')
            self.definitions[channel.topic].add(text)
            count = storage.counts[channel.id]
            known = self.topics.get(channel.topic)
            if known is not None:
                self.topics[channel.topic] = replace(known, count=known.count + count)
                continue
            self.topics[channel.topic] = TopicInfo(
                name=channel.topic,
                type=_type(storage, channel.schema_id),
                count=count,
                qos=read_qos(channel.metadata.get('offered_qos_profiles'), storage.path),
                type_hash=channel.metadata.get('topic_type_hash', ''),
                serialization=channel.message_encoding,
            )


def _storage(file: Path, bag: Path, files: int) -> Storage:
    """Return a file of a bag; raises BagError, with a fix for the whole bag."""
    try:
        return Storage(file, bag)
    except BagError as error:
        if files > 1 and 'shepherd bag recover' not in str(error):
            raise BagError(error.path, error.reason, recover_hint(bag)) from error
        raise


def recover_hint(bag: Path) -> str:
    """Return the fix where one file of a bag is missing or empty."""
    return f'put it back, or run `shepherd bag recover {bag}` to keep the other files'


def _type(storage: Storage, schema: int) -> str:
    return storage.schemas[schema].name if schema in storage.schemas else ''
