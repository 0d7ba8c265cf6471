"""Recovery of a damaged bag into a new one; the damaged one stays as it is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
import shutil
import tempfile

from mcap.records import Channel
from shepherd_ros.rosbag2.errors import BagError, DamageError, unreadable
from shepherd_ros.rosbag2.metadata import Metadata, NO_START
from shepherd_ros.rosbag2.qos import Qos, read_qos
from shepherd_ros.rosbag2.reader import mcap_files
from shepherd_ros.rosbag2.salvage import Salvage
from shepherd_ros.rosbag2.writer import BagWriter

OnMessage = Callable[[dict[str, str], str, bytes], None]


@dataclass
class RecoverResult:
    """Counts of recovered and lost messages."""

    folder: Path  # of the new bag
    messages: int = 0
    topics: dict[str, int] = field(default_factory=dict)  # messages kept, by topic
    lost_bytes: int = 0  # that could not be read
    lost_chunks: int = 0  # at least
    files: int = 0  # that were read
    refused: list[str] = field(default_factory=list)  # why files could not be read at all
    dropped: Counter[str] = field(default_factory=Counter)  # what can be read but not be kept

    @property
    def whole(self) -> bool:
        """Return whether all that can be read was kept."""
        return not (self.refused or self.dropped)

    def text(self) -> str:
        """Return the result in lines for a terminal."""
        lines = [f'{self.folder}: {self.messages} messages kept of {self.files} files']
        lines += [f'  {topic}: {count}' for topic, count in sorted(self.topics.items())]
        lines.append(f'lost: {self.lost_bytes} bytes in {self.lost_chunks} places')
        lines += [f'not kept: {count} {what}' for what, count in sorted(self.dropped.items())]
        return '\n'.join(lines + self.refused)


def recovered_folder(path: Path) -> Path:
    """Return the default folder of the recovered bag: beside the damaged one."""
    whole = path.resolve()
    return whole.with_name(f'{whole.name if whole.is_dir() else whole.stem}_recovered')


def recover(
    path: Path | str,
    folder: Path | str | None = None,
    *,
    compression: str = 'none',
    on_message: OnMessage = lambda custom, topic, cdr: None,
) -> RecoverResult:
    """
    Write the readable part of a bag, a folder or one .mcap file, into a new folder.

    The new folder appears when it is complete. on_message(custom data, topic, CDR) is called
    before each message is written, and may change the custom data of the bag. Raises BagError if
    nothing is there to read, or if the new bag cannot be written.
    """
    path = Path(path)
    try:
        files = mcap_files(path) if path.is_dir() else [path]
    except OSError as error:
        raise unreadable(path, error) from error
    target = recovered_folder(path) if folder is None else Path(folder)
    if target.exists():
        raise BagError(target, 'it exists already', 'choose another folder or remove this one')
    result = RecoverResult(target)
    sources = list(_sources(files, result))
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f'.{target.name}.', dir=target.parent))
    except OSError as error:
        raise BagError(
            target, f'it cannot be created ({error.strerror})', 'choose another folder'
        ) from error
    try:
        _rewrite(sources, temporary / target.name, compression, result, on_message)
        (temporary / target.name).rename(target)
    except OSError as error:
        raise BagError(
            target, f'it cannot be written ({error.strerror})', 'choose another folder'
        ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return result


def _sources(files: list[Path], result: RecoverResult) -> Iterable[Salvage]:
    """Yield the files that can be read; raises BagError if there is none."""
    errors = []
    for file in files:
        try:
            yield Salvage(file)
            result.files += 1
        except BagError as error:
            errors.append(error)
        except OSError as error:
            errors.append(unreadable(file, error))
    if len(errors) == len(files):
        raise errors[0]
    result.refused = [str(error) for error in errors]


def _rewrite(
    sources: list[Salvage],
    folder: Path,
    compression: str,
    result: RecoverResult,
    on_message: OnMessage,
) -> None:
    metadata = _metadata(sources)
    with BagWriter(
        folder, compression=compression, custom_data=metadata.custom_data, distro=metadata.distro
    ) as writer:
        for number, source in enumerate(sources):
            if number:
                writer.split()
            reason_by_channel: dict[int, str] = {}  # why a channel cannot be written, '' if it can
            try:
                for message in source:
                    channel = source.channels[message.channel]
                    if channel.id not in reason_by_channel:
                        reason_by_channel[channel.id] = _add(writer, source, channel)
                    reason = reason_by_channel[channel.id]
                    if message.log_ns >= NO_START:
                        reason = reason or f'messages on {channel.topic} of after the year 2262'
                    if reason:
                        result.dropped[reason] += 1
                        result.lost_bytes += len(message.data)
                        continue
                    publish_ns = min(message.publish_ns, NO_START)
                    on_message(writer.custom_data, channel.topic, message.data)
                    writer.write(channel.topic, message.data, message.log_ns, publish_ns)
                    result.messages += 1
                    result.topics[channel.topic] = result.topics.get(channel.topic, 0) + 1
            except OSError as error:  # of the damaged file, as the writer raises BagError
                result.refused.append(str(unreadable(source.path, error)))
            except DamageError as error:  # somebody else cuts it while it is read
                result.refused.append(f'{source.path}: {error}')
            for channel in source.channels.values():
                if channel.id not in reason_by_channel:
                    _add(writer, source, channel)
            writer.custom_data.update(_metadata([source]).custom_data)  # as it was at the end
            result.dropped.update(source.unsupported)
            result.lost_bytes += source.lost_bytes
            result.lost_chunks += source.lost_chunks


def _add(writer: BagWriter, source: Salvage, channel: Channel) -> str:
    """Add a topic as it was recorded; return why it cannot be written, '' if it can."""
    schema = source.schemas.get(channel.schema_id)
    if schema is None and channel.schema_id:
        return f'messages on {channel.topic}, whose type is lost'
    try:
        writer.add_topic(
            channel.topic,
            schema.name if schema else '',
            _qos(channel, source.path),
            schema=(schema.encoding, schema.data) if schema else ('', b''),
            hash_text=channel.metadata.get('topic_type_hash', ''),
            serialization=channel.message_encoding,
        )
    except BagError as error:
        if writer.closed:
            raise
        return f'messages: {error.reason}; the first type is kept'
    return ''


def _qos(channel: Channel, path: Path) -> tuple[Qos, ...]:
    try:
        return read_qos(channel.metadata.get('offered_qos_profiles'), path)
    except BagError:
        return ()


def _metadata(sources: list[Salvage]) -> Metadata:
    """Return the metadata of the first file that has any; empty fields without."""
    for source in sources:
        try:
            return Metadata.from_yaml(source.text, source.path)
        except BagError:
            continue
    return Metadata(distro='')
