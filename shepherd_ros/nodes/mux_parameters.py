"""The parameters of mux: sources and locks by name, as twist_mux has them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
import re

from shepherd_ros.config import ConfigError
from shepherd_ros.nodes.command_mux import AUTO, check_priorities, CommandSource, Lock
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.wire.topics import COMMANDS, lock_topic, source_topic

FRAMES = ('world', 'body')
HIGHEST = 255  # priority
LOWEST_TIMEOUT = 0.01  # [s]
_RESERVED = (AUTO, 'lock')  # names of services beside those of sources
_BUILT_IN = {  # name -> priority, timeout [s], whether it answers states, frame
    'console': (80, 0.3, False, 'world'),
    'keys': (90, 0.6, False, 'body'),  # a key that is held repeats after half a second
    'joy': (100, 0.5, False, 'body'),
}
_CONTROLLER = (10, 3.0, True, 'world')
_OTHER = (50, 0.5, False, 'world')


@dataclass(frozen=True)
class MuxOptions:
    """What the parameters of mux say."""

    sources: tuple[CommandSource, ...]
    locks: tuple[Lock, ...]
    default: str
    start_timeout: float  # [s]
    topics: dict[str, str]  # of sources, by name
    lock_topics: dict[str, str]  # of locks, by name
    body: frozenset[str]  # sources that command in the frame of the body
    stamped: bool  # whether flock_sim hears TwistStamped


def declare_source(node: ShepherdNode) -> str:
    """Declare to which source of mux a controller belongs; return the topic of its commands."""
    name = node.option(
        'source', '', 'name as a source of mux, which hears shepherd_{h}/cmd_vel/NAME; empty: '
        'commands go to flock_sim',
    )  # fmt: skip
    return source_topic(_checked_name('source', name)) if name else COMMANDS


def _checked_name(room: str, name: str) -> str:
    """Return the name of a source or a lock; ConfigError if it cannot be one."""
    if not re.fullmatch('[a-z][a-z0-9_]*', name) or name in _RESERVED:
        raise ConfigError(
            f'{room} has {name!r}: expected lower-case letters, digits and _, and none of '
            f'{", ".join(_RESERVED)}'
        )
    return name


def _checked_topic(name: str, topic: str) -> str:
    """Return the topic of a source or a lock; ConfigError if it is no name of one."""
    if not re.fullmatch(r'~?/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*', topic.replace('{h}', '0')):
        raise ConfigError(
            f'{name} is {topic!r}: expected the name of a topic, such as '
            'shepherd_{h}/cmd_vel/keys, in which {h} is the index of a shepherd'
        )
    return topic


def _names(node: ShepherdNode, room: str, known: Iterable[str]) -> list[str]:
    """Return the names in a room of the parameters, those that the user gave last."""
    given = {
        key.split('.')[1] for key in node.overrides or () if re.match(rf'{room}\.[^.]+\.', key)
    }
    return [_checked_name(room, name) for name in dict.fromkeys([*known, *sorted(given)])]


def _declare_source(node: ShepherdNode, name: str, default: str) -> tuple[CommandSource, str, str]:
    """Return a source with its topic and the frame of its commands."""
    preset = _CONTROLLER if name == default else _BUILT_IN.get(name, _OTHER)
    room = f'topics.{name}'
    topic = node.option(
        f'{room}.topic', source_topic(name), 'topic of the source; {h} is a shepherd'
    )
    priority = node.option(
        f'{room}.priority', preset[0], 'the source of highest priority that is not silent drives',
        low=1, high=HIGHEST,
    )  # fmt: skip
    timeout = node.option(
        f'{room}.timeout', preset[1], 'without a command for so long [s] the source is silent',
        low=LOWEST_TIMEOUT,
    )  # fmt: skip
    answers = node.option(
        f'{room}.answers', preset[2], 'it answers every state with a command of its stamp, as '
        'controllers do; false: its last command holds',
    )  # fmt: skip
    frame = node.option(
        f'{room}.frame', preset[3], 'frame of its commands; body: x is where the shepherd looks, '
        'angular z turns it', choices=FRAMES,
    )  # fmt: skip
    source = CommandSource(name, priority, timeout, answers)
    return source, _checked_topic(f'{room}.topic', topic), frame


def _declare_lock(node: ShepherdNode, name: str) -> tuple[Lock, str]:
    """Return a lock with its topic."""
    room = f'locks.{name}'
    topic = node.option(f'{room}.topic', lock_topic(name), 'topic of the lock, std_msgs/Bool')
    priority = node.option(
        f'{room}.priority', HIGHEST, 'sources of lower priority are locked', low=1, high=HIGHEST
    )
    timeout = node.option(
        f'{room}.timeout', 0.0, 'without a message for so long [s] it locks; 0: never', low=0.0
    )
    return Lock(name, priority, timeout), _checked_topic(f'{room}.topic', topic)


def declare_mux(node: ShepherdNode) -> MuxOptions:
    """Declare the parameters of sources and locks; ConfigError names one that cannot be."""
    default = node.option(
        'default', 'policy', 'source of the controller, which drives where no person does; the '
        'first state is not answered before it is heard',
    )  # fmt: skip
    start_timeout = node.option(
        'start_timeout', 60.0, 'lockstep: the default source is waited for at the start for so '
        'long [s]', low=0.0,
    )  # fmt: skip
    stamped = node.option(
        'stamped', True, 'publish TwistStamped; false: Twist, for a flock_sim with stamped:=false'
    )
    names = _names(node, 'topics', [default, *_BUILT_IN])
    sources = [_declare_source(node, name, default) for name in names]
    locks = [_declare_lock(node, name) for name in _names(node, 'locks', ())]
    options = MuxOptions(
        sources=tuple(source for source, _, _ in sources),
        locks=tuple(lock for lock, _ in locks),
        default=default,
        start_timeout=start_timeout,
        topics={source.name: topic for source, topic, _ in sources},
        lock_topics={lock.name: topic for lock, topic in locks},
        body=frozenset(source.name for source, _, frame in sources if frame == 'body'),
        stamped=stamped,
    )
    check_priorities(options.sources, options.locks)
    return options
