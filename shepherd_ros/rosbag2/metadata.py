"""Metadata of rosbag2 in ROS 2 Jazzy: version 9, in metadata.yaml and in MCAP."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.rosbag2.qos import dump_yaml, line_of, load_yaml, Qos, read_qos, text_of

VERSION, DISTRO, STORAGE = 9, 'jazzy', 'mcap'
FILE, KEY = 'metadata.yaml', 'rosbag2_bagfile_information'
NO_START = 2**63 - 1  # [ns] start of a bag without messages


@dataclass(frozen=True)
class TopicInfo:
    """A topic of a bag and the number of its messages."""

    name: str
    type: str
    count: int = 0
    qos: tuple[Qos, ...] = ()
    type_hash: str = ''
    serialization: str = 'cdr'

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of metadata.yaml, its keys in the order of rosbag2."""
        topic = {
            'name': self.name,
            'type': self.type,
            'serialization_format': self.serialization,
            'offered_qos_profiles': [profile.to_dict() for profile in self.qos],
            'type_description_hash': self.type_hash,
        }
        return {'topic_metadata': topic, 'message_count': self.count}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], path: Path) -> TopicInfo:
        """Return the topic of an entry of any version."""
        topic = data['topic_metadata']
        return cls(
            name=text_of(topic['name']),
            type=text_of(topic['type']),
            count=int(data['message_count']),
            qos=read_qos(topic.get('offered_qos_profiles'), path),
            type_hash=text_of(topic.get('type_description_hash', '')),
            serialization=text_of(topic['serialization_format']),
        )


@dataclass(frozen=True)
class FileInfo:
    """One file of a bag; start and duration of its messages in ns."""

    path: str
    start_ns: int = NO_START
    duration_ns: int = 0
    count: int = 0

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of metadata.yaml, its keys in the order of rosbag2."""
        return {
            'path': self.path,
            'starting_time': {'nanoseconds_since_epoch': self.start_ns},
            'duration': {'nanoseconds': self.duration_ns},
            'message_count': self.count,
        }


@dataclass(frozen=True)
class Metadata:
    """Content of metadata.yaml; totals of the bag follow from files and topics."""

    topics: tuple[TopicInfo, ...] = ()
    files: tuple[FileInfo, ...] = ()
    custom_data: dict[str, str] = field(default_factory=dict)
    version: int = VERSION
    storage: str = STORAGE
    compression_format: str = ''
    compression_mode: str = ''
    distro: str = DISTRO

    def to_dict(self) -> dict[str, Any]:
        """Return the map of version 9, in the order of rosbag2."""
        start = min((f.start_ns for f in self.files), default=NO_START)
        ends = [f.start_ns + f.duration_ns for f in self.files if f.count]
        return {
            'version': VERSION,
            'storage_identifier': self.storage,
            'duration': {'nanoseconds': max(ends) - start if ends else 0},
            'starting_time': {'nanoseconds_since_epoch': start},
            'message_count': sum(f.count for f in self.files),
            'topics_with_message_count': [topic.to_dict() for topic in self.topics],
            'compression_format': self.compression_format,
            'compression_mode': self.compression_mode,
            'relative_file_paths': [f.path for f in self.files],
            'files': [f.to_dict() for f in self.files],
            'custom_data': dict(self.custom_data) or None,
            'ros_distro': self.distro,
        }

    def to_yaml(self) -> str:
        """Return the text of the record in an MCAP file."""
        return dump_yaml(self.to_dict())

    def document(self) -> str:
        """Return the text of metadata.yaml."""
        return dump_yaml({KEY: self.to_dict()})

    @classmethod
    def from_yaml(cls, text: str, path: Path) -> Metadata:
        """Return the metadata in a text, map or document, of any version; raises BagError."""
        data = load_yaml(text, path)
        try:
            data = data.get(KEY, data)
            start = int(data['starting_time']['nanoseconds_since_epoch'])
            files = tuple(
                FileInfo(
                    text_of(row['path']),
                    int(row['starting_time']['nanoseconds_since_epoch']),
                    int(row['duration']['nanoseconds']),
                    int(row['message_count']),
                )
                for row in data.get('files') or ()
            ) or tuple(FileInfo(text_of(name), start) for name in data['relative_file_paths'])
            custom = data.get('custom_data') or {}
            return cls(
                topics=tuple(
                    TopicInfo.from_dict(row, path) for row in data['topics_with_message_count']
                ),
                files=files,
                custom_data={text_of(key): text_of(value) for key, value in custom.items()},
                version=int(data['version']),
                storage=text_of(data['storage_identifier']),
                compression_format=text_of(data.get('compression_format') or ''),
                compression_mode=text_of(data.get('compression_mode') or ''),
                distro=text_of(data.get('ros_distro') or ''),
            )
        except (KeyError, AttributeError, TypeError, ValueError, OverflowError) as error:
            if isinstance(error, BagError):
                raise
            raise BagError(path, f'its metadata cannot be read ({line_of(error)})') from error
