"""Compares two bags by what their messages say, as padding in CDR is not reproducible."""

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
    """A topic in two bags: how many messages, and where they first differ."""

    topic: str
    left: int  # messages
    right: int
    index: int | None = None  # of the first message that differs
    what: str = ''  # such as poses[3].position.x: 1.0 and 2.0

    @property
    def equal(self) -> bool:
        """Return whether counts and contents are equal."""
        return self.left == self.right and self.index is None

    def __str__(self) -> str:
        """Return the comparison in one line."""
        if self.equal:
            return f'{self.topic}: {self.left} equal messages'
        counts = f'{self.topic}: {self.left} and {self.right} messages'
        return counts if self.index is None else f'{counts}; number {self.index}: {self.what}'


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
    Compare the messages of each topic in their order; raises BagError where a bag is damaged.

    NaN equals NaN. times: the log times have to be equal too. once: only without_repeats() of
    both. Messages of one bag wait in memory until the other has come as far.
    """
    counts: tuple[Counter[str], Counter[str]] = Counter(), Counter()
    waiting: defaultdict[str, deque[BagMessage]] = defaultdict(deque)
    ahead: dict[str, int] = {}  # which bag has messages waiting
    first: dict[str, tuple[int, str]] = {}
    bags, decoders = (left, right), (Decoder(left), Decoder(right))
    rows = [without_repeats(bag.messages()) if once else bag.messages() for bag in bags]
    for pair in zip_longest(*rows):
        for side, message in enumerate(pair):
            if message is None:
                continue
            topic = message.topic
            counts[side][topic] += 1
            other = bags[1 - side].topics.get(topic)
            if topic in first or other is None or counts[side][topic] > other.count:
                continue
            queue = waiting[topic]
            if not queue or ahead[topic] == side:
                queue.append(message)
                ahead[topic] = side
                continue
            both = (queue.popleft(), message) if side else (message, queue.popleft())
            what = _difference(both, decoders, times)
            if what:
                first[topic] = counts[side][topic] - 1, what
                queue.clear()
    names = sorted({*left.topics, *right.topics})
    return DiffResult(
        [TopicDiff(n, counts[0][n], counts[1][n], *first.get(n, (None, ''))) for n in names]
    )


def without_repeats(messages: Iterable[BagMessage]) -> Iterator[BagMessage]:
    """
    Yield messages but those that say exactly the same as the one before them on their topic.

    flock_sim shows a state again that nobody answers, and its readers answer again. That has the
    same stamp again; what has no stamp, such as metrics, can stay the same from state to state
    too, and then counts once as well.
    """
    before: dict[str, bytes] = {}
    for message in messages:
        content = message.data.rstrip(b'\0')  # padding at the end says nothing
        if before.get(message.topic) != content:
            before[message.topic] = content
            yield message


class Decoder:
    """Decodes any message of a bag by the schemas that the bag carries."""

    def __init__(self, bag: Bag) -> None:
        """Take the schemas; they are read when they are needed."""
        self.bag = bag
        self.store = get_typestore(Stores.EMPTY)
        self.usable: dict[str, bool] = {}

    def knows(self, type_name: str) -> bool:
        """Return whether messages of a type can be decoded."""
        if type_name not in self.usable:
            encoding, text = self.bag.schemas.get(type_name, ('', b''))
            texts = {row for rows in self.bag.definitions.values() for row in rows}
            one = sum(name == type_name for name, _, _ in texts) == 1
            self.usable[type_name] = one and encoding == 'ros2msg'
            if self.usable[type_name]:
                try:
                    types = get_types_from_msg(text.decode(), _as_message(type_name))
                    missing = {k: v for k, v in types.items() if k not in self.store.types}
                    self.store.register(missing)
                except Exception:  # whatever the parser makes of a foreign text
                    self.usable[type_name] = False
        return self.usable[type_name]

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
    """Return the name under which rosbags keeps a type: it knows no parts of services."""
    return type_name.replace('/srv/', '/msg/')


def _difference(
    pair: tuple[BagMessage, BagMessage], decoders: tuple[Decoder, Decoder], times: bool
) -> str:
    """Return where two messages differ first, '' if they are equal."""
    left, right = pair
    if left.type != right.type:
        return f'types {left.type} and {right.type}'
    if times and left.log_ns != right.log_ns:
        return f'log times {left.log_ns} and {right.log_ns} ns'
    if left.data == right.data:
        return ''
    if not all(decoder.knows(left.type) for decoder in decoders):
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
            same = (left == right) | ((left != left) & (right != right))
            k = int(np.argmin(same))
            yield f'{path}[{k}]: {left[k]} and {right[k]}'
    else:
        for k, (one, other) in enumerate(zip(left, right, strict=True)):
            yield from differences(one, other, f'{path}[{k}]')


def _is_row(value: Any) -> bool:
    return isinstance(value, list | tuple | np.ndarray)
