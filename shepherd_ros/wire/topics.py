"""The topics, read from msg_schemas/topics.yaml: the one contract that nodes and tools share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from shepherd_ros.resources import share_file
import yaml


@dataclass(frozen=True)
class Profile:
    """Quality of service: what a publisher offers, and what our subscribers ask for."""

    reliability: str
    durability: str
    depth: int
    subscribe: str = ''  # reliability of subscribers, that of the publisher if empty


@dataclass(frozen=True)
class Topic:
    """One line of the contract; {h} in the name stands for the index of a shepherd."""

    name: str
    type: str
    profile: str
    frame: str
    unit: str
    publisher: tuple[str, ...]
    subscribers: tuple[str, ...]
    meaning: str
    alternative: str = ''


@cache
def contract() -> tuple[dict[str, Topic], dict[str, Profile]]:
    """Return topics by name and profiles by name."""
    data = yaml.safe_load(share_file('msg_schemas', 'topics.yaml').read_text(encoding='utf-8'))
    topics = {}
    for row in data['topics']:
        for many in ('publisher', 'subscribers'):
            row[many] = tuple(row[many])
        topics[row['name']] = Topic(**row)
    return topics, {name: Profile(**row) for name, row in data['profiles'].items()}


def topic_table() -> str:
    """Return the contract as the table of README.md."""
    rows = [
        '| topic | type | quality | frame | unit | from | to | meaning |',
        '|---|---|---|---|---|---|---|---|',
    ]
    for topic in contract()[0].values():
        kinds = [kind.replace('/msg/', '/') for kind in (topic.type, topic.alternative) if kind]
        cells = (
            f'`{topic.name}`',
            ' or '.join(kinds),
            topic.profile,
            topic.frame,
            topic.unit,
            ', '.join(topic.publisher),
            ', '.join(topic.subscribers),
            topic.meaning,
        )
        rows.append('| ' + ' | '.join(cells) + ' |')
    return '\n'.join(rows) + '\n'


def renamed_topics(namespace: str, n_shepherds: int) -> list[tuple[str, str]]:
    """Return remaps for a viewer that has the topics of no namespace, to see those of one."""
    if not namespace.strip('/'):
        return []
    names = [
        name.format(h=h)
        for name in contract()[0]
        if not name.startswith('/')
        for h in range(n_shepherds if '{h}' in name else 1)
    ]
    return [(f'/{name}', f'/{namespace.strip("/")}/{name}') for name in names]
