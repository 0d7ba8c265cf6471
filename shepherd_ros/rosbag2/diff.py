"""Comparison of two bags by the content of their messages: padding in CDR is not reproducible."""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from itertools import zip_longest
from typing import Any

import numpy as np
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from shepherd_ros.rosbag2.bag import Bag, BagMessage
from shepherd_ros.rosbag2.errors import BagError


@dataclass(frozen=True)
class TopicDiff:
    """A topic in two bags: the numbers of its messages, and their first difference."""

    topic: str
    left: int  # messages
    right: int
    index: int | None = None  # of the first message that differs
    difference: str = ''  # such as poses[3].position.x: 1.0 and 2.0

    @property
    def equal(self) -> bool:
        """Return whether counts and contents are equal."""
        return self.left == self.right and self.index is None

    def __str__(self) -> str:
        """Return the comparison in one line."""
        if self.equal:
            return f'{self.topic}: {self.left} equal messages'
        counts = f'{self.topic}: {self.left} and {self.right} messages'
        return (
            counts if self.index is None else f'{counts}; number {self.index}: {self.difference}'
        )


@dataclass(frozen=True)
class DiffResult:
    """The comparison of two bags."""

    topics: list[TopicDiff]

    @property
    def equal(self) -> bool:
        """Return whether the contents are equal."""
        return all(topic.equal for topic in self.topics)

    def text(self) -> str:
        """Return the comparison in lines for a terminal."""
        lines = [str(topic) for topic in self.topics]
        return '\n'.join([*lines, 'equal' if self.equal else 'different'])


def diff_bags(left: Bag, right: Bag, *, times: bool = False, once: bool = False) -> DiffResult:
    """
    Return the differences of the messages of each topic; raises BagError where a bag is damaged.

    NaN equals NaN. times: the log times have to be equal too. once: only without_repeats() of
    both. Messages of one bag wait in memory until the other has as many.
    """
    counts: tuple[Counter[str], Counter[str]] = Counter(), Counter()
    queues: defaultdict[str, deque[BagMessage]] = defaultdict(deque)
    ahead: dict[str, int] = {}  # which bag has messages waiting
    first: dict[str, tuple[int, str]] = {}
    bags, decoders = (left, right), (Decoder(left), Decoder(right))
    streams = [without_repeats(bag.messages()) if once else bag.messages() for bag in bags]
    for pair in zip_longest(*streams):
        for side, message in enumerate(pair):
            if message is None:
                continue
            topic = message.topic
            counts[side][topic] += 1
            other = bags[1 - side].topics.get(topic)
            if topic in first or other is None or counts[side][topic] > other.count:
                continue
            queue = queues[topic]
            if not queue or ahead[topic] == side:
                queue.append(message)
                ahead[topic] = side
                continue
            compared = (queue.popleft(), message) if side else (message, queue.popleft())
            difference = _difference(compared, decoders, times)
            if difference:
                first[topic] = counts[side][topic] - 1, difference
                queue.clear()
    names = sorted({*left.topics, *right.topics})
    return DiffResult(
        [TopicDiff(n, counts[0][n], counts[1][n], *first.get(n, (None, ''))) for n in names]
    )


def without_repeats(messages: Iterable[BagMessage]) -> Iterator[BagMessage]:
    """
    Yield messages but those with the same content as the one before them on their topic.

    flock_sim publishes a state again without a response, and its readers answer again, with the
    same stamp. Messages without a stamp, such as metrics, can stay the same from state to state
    too, and then count once as well.
    """
    last_data: dict[str, bytes] = {}
    for message in messages:
        content = message.data.rstrip(b'\0')  # padding at the end says nothing
        if last_data.get(message.topic) != content:
            last_data[message.topic] = content
            yield message


class Decoder:
    """Decodes any message of a bag by the schemas that the bag carries."""

    def __init__(self, bag: Bag) -> None:
        """Use the schemas of a bag, which are parsed when they are needed."""
        self.bag = bag
        self.store = get_typestore(Stores.EMPTY)
        self._decodable: dict[str, bool] = {}

    def can_decode(self, type_name: str) -> bool:
        """Return whether messages of a type can be decoded."""
        if type_name not in self._decodable:
            encoding, text = self.bag.schemas.get(type_name, ('', b''))
            texts = {row for rows in self.bag.definitions.values() for row in rows}
            unambiguous = sum(name == type_name for name, _, _ in texts) == 1
            self._decodable[type_name] = unambiguous and encoding == 'ros2msg'
            if self._decodable[type_name]:
                try:
                    types = get_types_from_msg(text.decode(), _as_message(type_name))
                    new_types = {k: v for k, v in types.items() if k not in self.store.types}
                    self.store.register(new_types)
                except Exception:  # whatever the parser makes of a foreign text
                    self._decodable[type_name] = False
        return self._decodable[type_name]

    def decode(self, message: BagMessage) -> Any:
        """Return a message as nested dataclasses of rosbags; raises BagError."""
        try:
            return self.store.deserialize_cdr(message.data, _as_message(message.type))
        except Exception as error:  # whatever the decoder makes of damaged bytes
            raise BagError(
                self.bag.path,
                f'{message.topic} at log time {message.log_ns} ns is no {message.type} '
                f'({type(error).__name__})',
            ) from error


def _as_message(type_name: str) -> str:
    """Return the name of a type in rosbags, which has no parts of services."""
    return type_name.replace('/srv/', '/msg/')


def _difference(
    pair: tuple[BagMessage, BagMessage], decoders: tuple[Decoder, Decoder], times: bool
) -> str:
    """Return the first difference of two messages, '' if they are equal."""
    left, right = pair
    if left.type != right.type:
        return f'types {left.type} and {right.type}'
    if times and left.log_ns != right.log_ns:
        return f'log times {left.log_ns} and {right.log_ns} ns'
    if left.data == right.data:
        return ''
    if not all(decoder.can_decode(left.type) for decoder in decoders):
        return 'bytes'
    values = (decoder.decode(message) for decoder, message in zip(decoders, pair, strict=True))
    return next(differences(*values), '')


def differences(left: Any, right: Any, path: str = '') -> Iterator[str]:
    """Yield the places where two decoded values differ; NaN equals NaN."""
    if is_dataclass(left) and is_dataclass(right):
        for f in fields(left):
            name = f'{path}.{f.name}' if path else f.name
            yield from differences(getattr(left, f.name), getattr(right, f.name, None), name)
    elif isinstance(left, Mapping | str | bytes) or not _is_row(left):
        # a NaN is the one thing that is not itself
        if left != right and not (left != left and right != right):
            yield f'{path}: {left!r:.60} and {right!r:.60}'
    elif not _is_row(right) or len(left) != len(right):
        yield f'{path}: {len(left)} and {len(right) if _is_row(right) else right!r:.60} entries'
    elif isinstance(left, np.ndarray) and left.dtype.kind in 'biuf':
        if not np.array_equal(left, right, equal_nan=left.dtype.kind == 'f'):
            equal = (left == right) | ((left != left) & (right != right))
            k = int(np.argmin(equal))
            yield f'{path}[{k}]: {left[k]} and {right[k]}'
    else:
        for k, (one, other) in enumerate(zip(left, right, strict=True)):
            yield from differences(one, other, f'{path}[{k}]')


def _is_row(value: Any) -> bool:
    return isinstance(value, list | tuple | np.ndarray)
