"""Bags of a recorder: one folder, or a folder in it for each part."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
import json
import os
from pathlib import Path

from shepherd_ros.nodes.recorder_options import RecorderOptions
from shepherd_ros.nodes.recorder_subscriptions import RecorderSubscriptions
from shepherd_ros.recordings.recording_writer import LOST_KEY, RecordingWriter
from shepherd_ros.rosbag2.metadata import DISTRO


class RecorderBags:
    """
    Writes messages into the open bag; each bag begins with all latched messages.

    Any method may raise BagError or OSError.
    """

    def __init__(
        self,
        folder: Path,
        options: RecorderOptions,
        subscriptions: RecorderSubscriptions,
        accepts: Callable[[str], bool],
    ) -> None:
        """Start without an open bag."""
        self.folder, self.options = folder, options
        self.subscriptions, self.losses, self.accepts = (
            subscriptions,
            subscriptions.losses,
            accepts,
        )
        self.writer: RecordingWriter | None = None
        self.topics: set[str] = set()  # topics in the bag that is open
        self.lost_at_open: Counter[str] = Counter()  # when it was opened
        # the last message of each publisher of a latched topic
        self.latched: defaultdict[str, dict[int, bytes]] = defaultdict(dict)
        self.parts = self.written = self.on_disk = 0
        self.written_before = 0  # in the bags that are closed

    def latch(self, name: str, sender: int, raw: bytes) -> None:
        """Keep the last latched message of a sender for the next bags."""
        last = self.latched[name]
        last.pop(sender, None)
        last[sender] = raw
        while len(last) > max(len(self.losses.publishers(name)), 1):
            del last[next(iter(last))]  # of a publisher that is gone

    def write(
        self, name: str, raw: bytes, log_ns: int, publish_ns: int, pending: set[int]
    ) -> None:
        """Write a message; the first opens a bag. pending: ids of latched ones that follow."""
        if self.writer is None:
            self.writer = self._open()
            for topic, last in self.latched.items():
                for content in last.values() if self.accepts(topic) else ():
                    if content is not raw and id(content) not in pending:
                        self._write(self.writer, topic, content, log_ns, publish_ns)
        self._write(self.writer, name, raw, log_ns, publish_ns)

    def flush(self) -> None:
        """Flush the messages so far to the disk, with the counts of losses."""
        if self.writer is not None:
            self._store_losses(self.writer)
            self.writer.flush()
            self.on_disk = self.written

    def close(self) -> None:
        """Finish the open bag."""
        if self.writer is not None:
            self._store_losses(self.writer)
            self.writer.close()
            self.on_disk = self.written
            self.writer = None

    def count_on_disk(self) -> None:
        """Count the messages on the disk, after an error of writing."""
        if self.writer is not None:
            topics_on_disk = self.writer.metadata().topics
            self.written = self.on_disk = self.written_before + sum(
                topic.count for topic in topics_on_disk
            )

    def _write(
        self, writer: RecordingWriter, name: str, raw: bytes, log_ns: int, publish_ns: int
    ) -> None:
        if name not in self.topics:
            writer.add_topic(name, **self.subscriptions.described(name))
            self.topics.add(name)
        writer.write(name, raw, log_ns, publish_ns)
        self.written += 1

    def _open(self) -> RecordingWriter:
        """Return a new bag: the folder itself, or the next part in it."""
        folder = self.folder
        if self.options.per_episode or self.parts:
            self.folder.mkdir(parents=True, exist_ok=True)
            folder = self.folder / f'episode_{self.parts:04d}'
        self.parts, self.written_before = self.parts + 1, self.written
        self.lost_at_open = self.losses.by_topic()
        self.topics.clear()
        return RecordingWriter(
            folder,
            compression=self.options.compression,
            split_bytes=self.options.max_bag_size,
            split_seconds=self.options.max_bag_duration,
            distro=os.environ.get('ROS_DISTRO', DISTRO),
        )

    def _store_losses(self, writer: RecordingWriter) -> None:
        lost = self.losses.by_topic() - self.lost_at_open
        writer.custom_data[LOST_KEY] = json.dumps(lost, sort_keys=True)
