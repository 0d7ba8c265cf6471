"""Writer of recordings: bags with the version of the contract in their metadata."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
import json
from pathlib import Path
from typing import Any

from shepherd_ros import __version__
from shepherd_ros.rosbag2.qos import Qos
from shepherd_ros.rosbag2.recover import recover, RecoverResult
from shepherd_ros.rosbag2.writer import BagWriter
from shepherd_ros.wire.contract import contract_hash, known, known_text, topic_hashes, type_hash
from shepherd_ros.wire.decode import CdrError, decode_string
from shepherd_ros.wire.topics import EPISODE, Profile

VERSION_KEY = 'shepherd_ros.version'
CONTRACT_KEY = 'shepherd_ros.contract'
TOPICS_KEY = 'shepherd_ros.topics'  # JSON: topic_hashes()
EPISODE_KEY = 'shepherd_ros.episode'
PROGRESS_STEP = 1000  # messages between two calls of on_progress
LOST_KEY = 'shepherd_ros.lost'  # JSON: how many messages the recorder missed, by topic


def _store_episode(custom_data: dict[str, str], topic: str, cdr: bytes) -> None:
    """Store the first episode in the custom data of a recording."""
    if CONTRACT_KEY in custom_data and EPISODE_KEY not in custom_data:
        entry = known(topic)
        if entry is not None and entry.topic.name == EPISODE:
            with suppress(CdrError):
                custom_data[EPISODE_KEY] = decode_string(cdr)


def recover_recording(
    path: Path | str,
    folder: Path | str | None = None,
    *,
    compression: str = 'none',
    on_progress: Callable[[int], None] = lambda messages: None,
) -> RecoverResult:
    """
    Recover a bag as recover() does; the metadata gets the first episode, as in recordings.

    on_progress(how many messages) is called now and then.
    """
    messages = 0

    def count_message(custom_data: dict[str, str], topic: str, cdr: bytes) -> None:
        nonlocal messages
        messages += 1
        if messages % PROGRESS_STEP == 0:
            on_progress(messages)
        _store_episode(custom_data, topic, cdr)

    return recover(path, folder, compression=compression, on_message=count_message)


def offered_qos(profile: Profile) -> Qos:
    """Return the quality of service that a publisher with a profile of the contract offers."""
    return Qos(profile.reliability, profile.durability, 'keep_last', profile.depth)


class RecordingWriter(BagWriter):
    """
    Writes one bag; use it in a with statement.

    The version of the package, hashes of the contract and the first episode go into the metadata,
    beside custom_data. Types of the contract need no schema.
    """

    def __init__(
        self, folder: Path | str, *, custom_data: Mapping[str, str] | None = None, **options: Any
    ) -> None:
        """Create the folder, which must not exist; options are those of BagWriter."""
        data = dict(custom_data or {})
        data.setdefault(VERSION_KEY, __version__)
        if CONTRACT_KEY not in data:
            data[CONTRACT_KEY] = contract_hash()
            data[TOPICS_KEY] = json.dumps(topic_hashes(), separators=(',', ':'))
        super().__init__(folder, custom_data=data, **options)

    def add_topic(
        self,
        name: str,
        type_name: str,
        qos: Sequence[Qos] = (),
        *,
        schema: tuple[str, bytes] | None = None,
        hash_text: str | None = None,
        serialization: str = 'cdr',
    ) -> None:
        """Add a topic; schema and hash_text are those of the contract by default."""
        if schema is None:
            schema = 'ros2msg', known_text(type_name)
            hash_text = type_hash(type_name) if hash_text is None else hash_text
        super().add_topic(
            name,
            type_name,
            qos,
            schema=schema,
            hash_text=hash_text or '',
            serialization=serialization,
        )

    def write(self, topic: str, cdr: bytes, log_ns: int, publish_ns: int) -> None:
        """Write a message with its log time and its publish time [ns]; raises BagError."""
        _store_episode(self.custom_data, topic, cdr)
        super().write(topic, cdr, log_ns, publish_ns)
