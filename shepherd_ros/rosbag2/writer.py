"""Writer of bags that rosbag2 of ROS 2 Jazzy opens: MCAP files and metadata.yaml."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType

from shepherd_ros.config import ConfigError, unknown_name
from shepherd_ros.rosbag2.bag_files import BagFiles
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.rosbag2.mcap_writer import PACKERS
from shepherd_ros.rosbag2.metadata import DISTRO, Metadata, TopicInfo
from shepherd_ros.rosbag2.qos import Qos
from shepherd_ros.rosbag2.records import MAX_RECORD_BYTES

CHUNK_SIZE = 256 << 10  # [bytes]
MAX_MESSAGE_BYTES = MAX_RECORD_BYTES // 2  # [bytes], so that a chunk with it can be read
MIN_SPLIT_BYTES = 1024  # [bytes], as in rosbag2
_FREE_SPACE = 'free space or choose another place, then record into a new folder'


class BagWriter:
    """
    Writes one bag; use it in a with statement.

    Messages written before a crash stay readable but for the last chunk; flush() ends a chunk
    early. When the disk is full, the bag is closed with all that can be kept, and BagError is
    raised. custom_data goes into the metadata, and may change until the end; so does distro, the
    distribution of ROS that the messages are from.
    """

    def __init__(
        self,
        folder: Path | str,
        *,
        compression: str = 'none',
        chunk_size: int = CHUNK_SIZE,
        split_bytes: int = 0,
        split_seconds: float = 0.0,
        custom_data: Mapping[str, str] | None = None,
        distro: str = DISTRO,
    ) -> None:
        """Create the folder, which must not exist; raises BagError. Splits: 0 for never."""
        if compression not in PACKERS:
            raise unknown_name('compression', compression, list(PACKERS))
        if not 1 <= chunk_size <= MAX_MESSAGE_BYTES:
            raise ConfigError(
                f'chunk_size is {chunk_size}: expected 1 to {MAX_MESSAGE_BYTES} bytes'
            )
        if split_bytes and split_bytes < MIN_SPLIT_BYTES:
            raise ConfigError(
                f'split_bytes is {split_bytes}: expected 0, or at least {MIN_SPLIT_BYTES}'
            )
        if not split_seconds >= 0:
            raise ConfigError(f'split_seconds is {split_seconds}: expected 0 or more')
        self.folder = Path(folder)
        self.split_bytes, self.split_ns = split_bytes, split_seconds * 1e9
        self.custom_data = dict(custom_data or {})
        self.count = 0  # messages taken
        self.closed = False
        try:
            self._files = BagFiles(self.folder, compression, chunk_size, self.custom_data, distro)
        except FileExistsError as error:
            raise BagError(
                self.folder, 'it exists already', 'choose another folder or remove this one'
            ) from error
        except OSError as error:
            raise BagError(
                self.folder, f'it cannot be created ({error.strerror})', _FREE_SPACE
            ) from error

    def __enter__(self) -> BagWriter:
        """Return the writer."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the bag, after an error too: all written messages are kept."""
        self.close()

    def add_topic(
        self,
        name: str,
        type_name: str,
        qos: Sequence[Qos] = (),
        *,
        schema: tuple[str, bytes],
        hash_text: str = '',
        serialization: str = 'cdr',
    ) -> None:
        """
        Add a topic; raises BagError if it was added with another type or schema.

        schema is encoding and text of its type, hash_text the hash of that.
        """
        known = self._files.topics.get(name)
        if known is not None:
            if known.type != type_name or self._files.schemas[name] != schema:
                other = type_name if known.type != type_name else f'another {type_name}'
                raise BagError(
                    self.folder,
                    f'{name} has type {known.type} and is offered as {other} too',
                    'record one of them, remap the other',
                )
            return
        topic = TopicInfo(
            name, type_name, qos=tuple(qos), type_hash=hash_text, serialization=serialization
        )
        self._guarded(lambda: self._files.add_topic(topic, *schema))

    def write(self, topic: str, cdr: bytes, log_ns: int, publish_ns: int) -> None:
        """Write a message with its log time and its publish time [ns]; raises BagError."""
        if topic not in self._files.topics:
            raise BagError(self.folder, f'{topic} is not in it', 'call add_topic() first')
        if not (0 <= log_ns < 2**63 and 0 <= publish_ns < 2**63 and len(cdr) < MAX_MESSAGE_BYTES):
            raise BagError(
                self.folder,
                f'{topic}: {len(cdr)} bytes at {log_ns} ns, sent at {publish_ns} ns',
                f'expected times in [0, 2^63) ns and fewer than {MAX_MESSAGE_BYTES} bytes',
            )
        if self._needs_split(log_ns):
            self.split()
        self._guarded(lambda: self._files.add_message(topic, log_ns, publish_ns, cdr))
        self.count += 1

    def flush(self) -> None:
        """Write all messages so far to the disk; raises BagError."""
        self._guarded(lambda: self._files.file.end_chunk())

    def split(self) -> None:
        """Finish the file and begin a new one; raises BagError."""
        self._guarded(self._files.split)

    def close(self) -> None:
        """Finish the files and write metadata.yaml; a second call does nothing."""
        if not self.closed:
            self._guarded(self._files.close)
            self.closed = True

    def metadata(self) -> Metadata:
        """Return the metadata of the bag, or that of the files on the disk while it is written."""
        return self._files.metadata()

    def _needs_split(self, log_ns: int) -> bool:
        """Return whether a message of this time belongs in a new file."""
        first = self._files.first_ns
        if self.closed or first is None:
            return False
        too_long = self.split_ns and log_ns - first > self.split_ns
        return bool(too_long or 0 < self.split_bytes <= self._files.written)

    def _guarded(self, action: Callable[[], None]) -> None:
        """Run an action on the files; on OSError rescue the bag and raise BagError."""
        if self.closed:
            raise BagError(self.folder, 'the bag is closed', 'record into a new folder')
        try:
            action()
        except OSError as error:
            self.closed = True
            self._files.rescue()
            raise BagError(
                self.folder,
                f'it cannot be written ({error.strerror}); {self._files.count} messages are kept',
                _FREE_SPACE,
            ) from error
