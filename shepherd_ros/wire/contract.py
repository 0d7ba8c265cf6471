"""Which topics of a bag are ours, and the hashes that say that two ends mean the same."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cache
import hashlib
import json
import re

from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from shepherd_ros.wire.schemas import schema_text, wire_types
from shepherd_ros.wire.topics import contract, Topic

CHANNELS = ('sheep', 'shepherds', 'goal')  # of a scan, in the order of the lidar
PROSE = ('publisher', 'subscribers', 'meaning')  # may change without any change on the wire


@dataclass(frozen=True)
class Known:
    """A topic of a bag that is in the contract."""

    topic: Topic
    namespace: str  # '' or such as /farm
    shepherd: int | None = None

    @property
    def types(self) -> tuple[str, ...]:
        """Return the types that it may have."""
        return tuple(kind for kind in (self.topic.type, self.topic.alternative) if kind)


@cache
def _patterns() -> list[tuple[re.Pattern[str], Topic]]:
    """Return what topics look like in a bag, the longest names first."""
    rows = sorted(contract()[0].values(), key=lambda row: -len(row.name))
    patterns = []
    for row in rows:
        name = re.escape(row.name).replace(r'\{h\}', r'(?P<h>0|[1-9]\d{0,5})')
        space = '(?P<space>)' if row.name.startswith('/') else r'(?P<space>(?:/\w+)*)/'
        patterns.append((re.compile(f'{space}{name}'), row))
    return patterns


@cache
def known(name: str) -> Known | None:
    """Return what the contract says of a topic of a bag, None if nothing."""
    for pattern, row in _patterns():
        match = pattern.fullmatch(name)
        if match is not None:
            shepherd = match.groupdict().get('h')
            return Known(row, match['space'], None if shepherd is None else int(shepherd))
    return None


@cache
def contract_hash() -> str:
    """
    Return the SHA-256 of the contract in hexadecimal: topics, profiles and texts of all types.

    What is said for people only (meaning, publisher, subscribers) does not count.
    """
    topics, profiles = contract()
    rows = [
        {key: value for key, value in asdict(row).items() if key not in PROSE}
        for _, row in sorted(topics.items())
    ]
    kinds = {name: asdict(profile) for name, profile in profiles.items()}
    texts = {kind: schema_text(kind) for kind in wire_types()}
    content = json.dumps([rows, kinds, texts], sort_keys=True, separators=(',', ':'))
    return hashlib.sha256(content.encode()).hexdigest()


@cache
def known_text(type_name: str) -> bytes:
    """Return the text of a type of the contract as it stands in a bag."""
    return schema_text(type_name).encode()


@cache
def type_hash(type_name: str) -> str:
    """Return the hash of a type of the contract as ROS 2 computes it: RIHS01_ and SHA-256."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema_text(type_name), type_name))
    return store.hash_rihs01(type_name)
