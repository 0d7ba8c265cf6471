"""Contract of topics: entries for a bag's topics, and hashes that compare two versions."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cache
import hashlib
import json
import re
from typing import Any

from shepherd_ros.wire.schemas import installed_text, nested_text, schema_text, wire_types
from shepherd_ros.wire.topics import contract, families, member, Topic, topic_pattern

HASHED_DEPTHS = {'command': 1, 'clock': 1}  # of queues that have become longer, no other meaning
PROSE_FIELDS = ('publisher', 'subscribers', 'meaning')  # may change without any change on the wire
HASH_LENGTH = 12  # characters of the hash of a topic
# contract_hash() when bags began to have one for each topic, which were then as they are
FIRST_CONTRACT_HASH = '57135bfda311c7fd6e26293ad7e9721224dca443640b9455ced35affab933188'


@dataclass(frozen=True)
class KnownTopic:
    """A topic of a bag that is in the contract."""

    topic: Topic
    namespace: str  # '' or such as /farm
    shepherd: int | None = None
    row: str = ''  # in the contract: the name of the topic, or of its family

    @property
    def types(self) -> tuple[str, ...]:
        """Return the types that the topic may have."""
        return tuple(kind for kind in (self.topic.type, self.topic.alternative) if kind)


@cache
def _patterns() -> list[tuple[re.Pattern[str], Topic]]:
    """Return the patterns of topic names in a bag, the longest first and families last."""
    rows = sorted(contract()[0].values(), key=lambda row: -len(row.name))
    patterns = []
    for row in (*rows, *families().values()):
        space = '(?P<space>)' if row.name.startswith('/') else r'(?P<space>(?:/\w+)*)/'
        name = topic_pattern(row.name, r'(?P<h>0|[1-9]\d{0,5})')
        patterns.append((re.compile(f'{space}{name}'), row))
    return patterns


@cache
def known(name: str) -> KnownTopic | None:
    """Return the entry of the contract for a topic of a bag, None without one."""
    for pattern, row in _patterns():
        match = pattern.fullmatch(name)
        if match is not None:
            groups = match.groupdict()
            shepherd = None if groups.get('h') is None else int(groups['h'])
            topic = member(row, groups['member']) if 'member' in groups else row
            return KnownTopic(topic, groups['space'], shepherd, row.name)
    return None


def _meaning(row: Topic) -> dict[str, str]:
    """Return the fields of a row that change the wire."""
    return {key: value for key, value in asdict(row).items() if key not in PROSE_FIELDS}


def _profile(name: str) -> dict[str, Any]:
    """Return the fields of a profile, with the depths of the first hashes."""
    profile = asdict(contract()[1][name])
    return profile | {'depth': HASHED_DEPTHS.get(name, profile['depth'])}


def _hash(content: Any) -> str:
    text = json.dumps(content, sort_keys=True, separators=(',', ':'))
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def topic_hashes() -> dict[str, str]:
    """Return a hash by row and family, of its fields, its profile and the texts of its types."""
    hashes = {}
    for name, row in (contract()[0] | families()).items():
        texts = [schema_text(kind) for kind in (row.type, row.alternative) if kind]
        hashes[name] = _hash([_meaning(row), _profile(row.profile), texts])[:HASH_LENGTH]
    return hashes


@cache
def contract_hash() -> str:
    """
    Return the SHA-256 of the contract in hexadecimal: topics, profiles and texts of all types.

    Fields of PROSE_FIELDS do not count. Bags from before topic_hashes() have this alone.
    """
    topics, profiles = contract()
    rows = [_meaning(row) for _, row in sorted(topics.items())]
    kinds = {name: _profile(name) for name in profiles}
    return _hash([rows, kinds, {kind: schema_text(kind) for kind in wire_types()}])


@cache
def known_text(type_name: str) -> bytes:
    """Return the text of a type of the contract, encoded as in a bag."""
    return schema_text(type_name).encode()


@cache
def text_hash(type_name: str, text: str) -> str:
    """Return the hash of a type as ROS 2 computes it, RIHS01_ and SHA-256; '' if not parsable."""
    from rosbags.typesys import get_types_from_msg, get_typestore, Stores  # 20 modules: late

    store = get_typestore(Stores.EMPTY)
    name = type_name.replace('/srv/', '/msg/')  # rosbags knows no parts of services
    try:
        store.register(get_types_from_msg(text, name))
        return store.hash_rihs01(name)
    except Exception:  # whatever the parser makes of a foreign text
        return ''


def type_hash(type_name: str) -> str:
    """Return the hash of a type of the contract as ROS 2 computes it."""
    return text_hash(type_name, schema_text(type_name))


def installed_hash(type_name: str) -> str:
    """Return the hash of an installed type, '' if it is not installed."""
    if type_name in wire_types():
        return type_hash(type_name)
    try:
        return text_hash(type_name, nested_text(type_name, installed_text))
    except FileNotFoundError:
        return ''
