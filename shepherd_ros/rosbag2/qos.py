"""Quality of service as rosbag2 writes it, and reading and writing of its YAML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from shepherd_ros.rosbag2.errors import BagError
import yaml

INFINITE = (9223372036, 854775807)  # s, ns
# words of a policy by the numbers that versions up to 8 have
POLICY_WORDS = {
    'history': ('system_default', 'keep_last', 'keep_all', 'unknown'),
    'reliability': ('system_default', 'reliable', 'best_effort', 'unknown', 'best_available'),
    'durability': (
        'system_default', 'transient_local', 'volatile', 'unknown', 'best_available',
    ),
    'liveliness': (
        'system_default', 'automatic', 'manual_by_node', 'manual_by_topic', 'unknown',
        'best_available',
    ),
}  # fmt: skip
MAX_YAML_BYTES = 16 << 20  # [bytes] of YAML
MAX_YAML_DEPTH = 30  # levels of nested lists and maps; rosbag2 has 8
_LOADER = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
_DUMPER = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)
_DURATIONS = ('deadline', 'lifespan', 'liveliness_lease_duration')


def dump_yaml(data: Any) -> str:
    """Return plain data as YAML, in the order given."""
    return str(yaml.dump(data, Dumper=_DUMPER, sort_keys=False, width=2**31 - 1))


def load_yaml(text: str, path: Path) -> Any:
    """Return the plain data of a YAML text of a file; raises BagError."""
    try:
        if len(text) > MAX_YAML_BYTES:
            raise ValueError(f'{len(text)} characters: expected at most {MAX_YAML_BYTES}')
        depth = 0
        for event in yaml.parse(text, Loader=_LOADER):  # libyaml has no limit but its stack
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_YAML_DEPTH:
                raise ValueError(f'more than {MAX_YAML_DEPTH} levels')
        return yaml.load(text, Loader=_LOADER)
    except (yaml.YAMLError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise BagError(path, f'its metadata is no YAML ({line_of(error)})') from error


def text_of(value: Any) -> str:
    """Return a scalar as text; raises ValueError for others, which aliases can make endless."""
    if isinstance(value, list | dict | tuple | set):
        raise ValueError(f'a {type(value).__name__}: expected text')
    return str(value)


def line_of(error: Exception) -> str:
    """Return the message of an error, in one line of at most 120 characters."""
    return ' '.join(str(error).split())[:120] or type(error).__name__


@dataclass(frozen=True)
class Qos:
    """Quality of service that a publisher offered, as rosbag2 writes it; durations in s, ns."""

    reliability: str = 'reliable'
    durability: str = 'volatile'
    history: str = 'unknown'  # what discovery says: it is not sent
    depth: int = 0
    deadline: tuple[int, int] = INFINITE
    lifespan: tuple[int, int] = INFINITE
    liveliness: str = 'automatic'
    liveliness_lease_duration: tuple[int, int] = INFINITE
    avoid_ros_namespace_conventions: bool = False

    def __post_init__(self) -> None:
        """Raise ValueError for words that rosbag2 does not know."""
        for policy, words in POLICY_WORDS.items():
            if getattr(self, policy) not in words:
                raise ValueError(
                    f'{policy} is {getattr(self, policy)!r}: expected one of {", ".join(words)}'
                )

    def to_dict(self) -> dict[str, Any]:
        """Return the policies as plain data, in the order of rosbag2."""
        names = (
            'history', 'depth', 'reliability', 'durability', 'deadline', 'lifespan',
            'liveliness', 'liveliness_lease_duration', 'avoid_ros_namespace_conventions',
        )  # fmt: skip
        data = {name: getattr(self, name) for name in names}
        for name in _DURATIONS:
            data[name] = dict(zip(('sec', 'nsec'), data[name], strict=True))
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Qos:
        """Return the policies in data of any version; raises KeyError, TypeError, ValueError."""
        values: dict[str, Any] = {}
        for policy, words in POLICY_WORDS.items():
            value = data[policy]
            values[policy] = words[value] if isinstance(value, int) else text_of(value)
        for name in _DURATIONS:
            values[name] = int(data[name]['sec']), int(data[name]['nsec'])
        avoid = bool(data['avoid_ros_namespace_conventions'])
        return cls(**values, depth=int(data['depth']), avoid_ros_namespace_conventions=avoid)


def history(profiles: tuple[Qos, ...]) -> int:
    """Return the number of messages that a late reader gets; 0 if any publisher is volatile."""
    if any(profile.durability != 'transient_local' for profile in profiles):
        return 0
    return sum(max(profile.depth, 1) for profile in profiles)


def agreed_policy(profiles: tuple[Qos, ...], policy: str) -> Any:
    """Return the value of a policy that all publishers offered, that of Qos() if they differ."""
    offers = {getattr(profile, policy) for profile in profiles}
    return offers.pop() if len(offers) == 1 else getattr(Qos(), policy)


def duration_ns(duration: tuple[int, int]) -> int:
    """Return a duration of s and ns in ns, 2^63 - 1 for those that rosbag2 calls infinite."""
    seconds, rest = duration
    infinite = seconds >= 2**31 - 1 or duration == (0, 0)  # in versions up to 8, or not set
    return 2**63 - 1 if infinite else seconds * 10**9 + rest


@lru_cache(maxsize=256)  # there are few that differ
def qos_yaml(profiles: tuple[Qos, ...]) -> str:
    """Return profiles as the YAML text that MCAP channels carry."""
    return dump_yaml([profile.to_dict() for profile in profiles])


def read_qos(data: Any, path: Path) -> tuple[Qos, ...]:
    """Return profiles from a list, or from a YAML text as up to version 8; raises BagError."""
    return _read_text(data, path) if isinstance(data, str) else _read_rows(data, path)


@lru_cache(maxsize=256)  # most topics have one of a few texts
def _read_text(text: str, path: Path) -> tuple[Qos, ...]:
    return _read_rows(load_yaml(text, path), path)


def _read_rows(rows: Any, path: Path) -> tuple[Qos, ...]:
    try:
        return tuple(Qos.from_dict(row) for row in rows or ())
    except (KeyError, IndexError, TypeError, ValueError, OverflowError) as error:
        raise BagError(path, f'quality of service cannot be read ({line_of(error)})') from error
