"""The topics, read from msg_schemas/topics.yaml: the one contract that nodes and tools share."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cache
import re
from typing import Any

from shepherd_ros.config import unknown_name
from shepherd_ros.resources import share_file
import yaml

WORLD_FRAME = 'map'  # unless a parameter says otherwise
SHEPHERD = 'shepherd_{h}'  # frame of a shepherd, and what its topics begin with
EPISODE, GOAL, CLOCK = 'episode', 'goal', '/clock'
GOAL_POSES = 'goal/poses'
SHEEP_POSES, SHEPHERD_POSES = 'flock/poses', 'shepherds/poses'
COMMANDS = f'{SHEPHERD}/cmd_vel'
DRIVERS, SELECT = 'drivers', 'mux/select'


def scan_topic(channel: str) -> str:
    """Return the topic of a channel of the lidars."""
    return f'{SHEPHERD}/scan/{channel}'


def source_topic(name: str) -> str:
    """Return the topic on which a source of mux commands each shepherd."""
    return f'{COMMANDS}/{name}'


def command_type(stamped: bool) -> str:
    """Return the type of commands: with the stamp of the state that they answer, or without."""
    row = row_of(COMMANDS)
    return row.type if stamped else row.alternative


def lock_topic(name: str) -> str:
    """Return the topic of a lock of mux."""
    return f'mux/locks/{name}'


def metric_topic(name: str) -> str:
    """Return the topic of a metric."""
    return f'metrics/{name}'


@dataclass(frozen=True)
class Profile:
    """Quality of service: offered by publishers, and requested by our subscribers."""

    reliability: str
    durability: str
    depth: int
    subscribe: str = ''  # reliability of subscribers, that of the publisher if empty


@dataclass(frozen=True)
class Topic:
    """
    One line of the contract; {h} in the name stands for the index of a shepherd.

    publisher and subscribers are executables, or roles: controller is each that answers poses.
    """

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
def _table() -> Any:
    """Return the contents of topics.yaml."""
    return yaml.safe_load(share_file('msg_schemas', 'topics.yaml').read_text(encoding='utf-8'))


def _rows(part: str) -> dict[str, Topic]:
    """Return the rows of a part of the file by name."""
    list_columns = ('publisher', 'subscribers')
    return {
        row['name']: Topic(**row | {name: tuple(row[name]) for name in list_columns})
        for row in _table()[part]
    }


@cache
def contract() -> tuple[dict[str, Topic], dict[str, Profile]]:
    """Return topics by name and profiles by name."""
    return _rows('topics'), {name: Profile(**row) for name, row in _table()['profiles'].items()}


@cache
def families() -> dict[str, Topic]:
    """Return the rows of many topics, by name: {member} in a name may be any word."""
    return _rows('families')


def topic_pattern(name: str, shepherd: str = re.escape('{h}')) -> str:
    """Return a regular expression for the topics of a row; shepherd: that of an index."""
    text = re.escape(name).replace(re.escape('{h}'), shepherd)
    return text.replace(re.escape('{member}'), r'(?P<member>[a-z][a-z0-9_]*)')


def member(family: Topic, name: str, **values: Any) -> Topic:
    """Return the row of one topic of a family, with other values of its fields."""
    return replace(family, name=family.name.replace('{member}', name), **values)


def row_of(name: str) -> Topic:
    """Return the row of a topic, of the contract or of a family in it, or raise ConfigError."""
    topics = contract()[0]
    if name in topics:
        return topics[name]
    for family in families().values():
        match = re.fullmatch(topic_pattern(family.name), name)
        if match is not None:
            return member(family, match['member'])
    raise unknown_name('topic', name, list(topics))


def topic_text(row: Topic) -> str:
    """Return a row as the text of topics.yaml."""
    lines = []
    for key, value in asdict(row).items():
        if value:
            text = f'[{", ".join(value)}]' if isinstance(value, tuple) else value
            lines.append(f'{key}: ' + (f"'{text}'" if text.isdigit() else text))
    return '- ' + '\n  '.join(lines) + '\n'


def topic_table() -> str:
    """Return the contract as a table in Markdown."""
    rows = [
        '| topic | type | quality | frame | unit | from | to | meaning |',
        '|---|---|---|---|---|---|---|---|',
    ]
    for row in contract()[0].values():
        kinds = [kind.replace('/msg/', '/') for kind in (row.type, row.alternative) if kind]
        cells = (
            f'`{row.name}`',
            ' or '.join(kinds),
            row.profile,
            row.frame,
            row.unit,
            ', '.join(row.publisher),
            ', '.join(row.subscribers),
            row.meaning,
        )
        rows.append('| ' + ' | '.join(cells) + ' |')
    return '\n'.join(rows) + '\n'


def renamed_topics(namespace: str, n_shepherds: int) -> list[tuple[str, str]]:
    """Return remaps (from, to) for a viewer without a namespace, to show the topics of one."""
    if not namespace.strip('/'):
        return []
    names = [
        name.format(h=h)
        for name in contract()[0]
        if not name.startswith('/')
        for h in range(n_shepherds if '{h}' in name else 1)
    ]
    return [(f'/{name}', f'/{namespace.strip("/")}/{name}') for name in names]
