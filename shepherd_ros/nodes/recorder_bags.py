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
    Writes messages into the bag that is open, each bag beginning with all that is latched.

    Any method may raise BagError or OSError.
    """

    def __init__(
        self,
        folder: Path,
        options: RecorderOptions,
        intake: RecorderSubscriptions,
        wanted: Callable[[str], bool],
    ) -> None:
        """Open nothing yet."""
        self.folder, self.options = folder, options
        self.intake, self.losses, self.wanted = intake, intake.losses, wanted
        self.writer: RecordingWriter | None = None
        self.announced: set[str] = set()  # topics in the bag that is open
        self.lost_before: Counter[str] = Counter()  # when it was opened
        # the last message of each publisher of a latched topic
        self.latched: defaultdict[str, dict[int, bytes]] = defaultdict(dict)
        self.parts = self.written = self.safe = 0
        self.written_before = 0  # in the bags that are closed

    def latch(self, name: str, sender: int, raw: bytes) -> None:
        """Keep a message for the bags that follow, instead of the sender's one before it."""
        last = self.latched[name]
        last.pop(sender, None)
        last[sender] = raw
        while len(last) > max(len(self.losses.publishers(name)), 1):
            del last[next(iter(last))]  # of a publisher that is gone

    def write(self, name: str, raw: bytes, log_ns: int, publish_ns: int, coming: set[int]) -> None:
        """Write one message; the first opens a bag. coming: ids of latched ones that follow."""
        if self.writer is None:
            self.writer = self._open()
            for topic, last in self.latched.items():
                for content in last.values() if self.wanted(topic) else ():
                    if content is not raw and id(content) not in coming:
                        self._put(self.writer, topic, content, log_ns, publish_ns)
        self._put(self.writer, name, raw, log_ns, publish_ns)

    def flush(self) -> None:
        """Put what was written so far on the disk, with what was lost."""
        if self.writer is not None:
            self._note_losses(self.writer)
            self.writer.flush()
            self.safe = self.written

    def close(self) -> None:
        """Finish the bag that is open."""
        if self.writer is not None:
            self._note_losses(self.writer)
            self.writer.close()
            self.safe = self.written
            self.writer = None

    def count_kept(self) -> None:
        """Count what is on the disk, after an error of writing."""
        if self.writer is not None:
            kept = self.writer.metadata().topics
            self.written = self.safe = self.written_before + sum(topic.count for topic in kept)

    def _put(
        self, writer: RecordingWriter, name: str, raw: bytes, log_ns: int, publish_ns: int
    ) -> None:
        if name not in self.announced:
            writer.add_topic(name, **self.intake.described(name))
            self.announced.add(name)
        writer.write(name, raw, log_ns, publish_ns)
        self.written += 1

    def _open(self) -> RecordingWriter:
        """Return a new bag: the folder itself, or the next part in it."""
        folder = self.folder
        if self.options.per_episode or self.parts:
            self.folder.mkdir(parents=True, exist_ok=True)
            folder = self.folder / f'episode_{self.parts:04d}'
        self.parts, self.written_before = self.parts + 1, self.written
        self.lost_before = self.losses.by_topic()
        self.announced.clear()
        return RecordingWriter(
            folder,
            compression=self.options.compression,
            split_bytes=self.options.max_bag_size,
            split_seconds=self.options.max_bag_duration,
            distro=os.environ.get('ROS_DISTRO', DISTRO),
        )

    def _note_losses(self, writer: RecordingWriter) -> None:
        lost = self.losses.by_topic() - self.lost_before
        writer.custom_data[LOST_KEY] = json.dumps(lost, sort_keys=True)
