"""The commands that a page may give: JSON texts with a name and checked fields, and no others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import json
from typing import Any

from shepherd_ros.config import checked, ConfigError, mapping, unknown_name
from shepherd_ros.sim.limits import MAX_FLOAT32, MAX_SEED, MAX_SHEPHERDS

MAX_TEXT = 200  # characters of a name that a page gives
MAX_SPEED = 1e3  # [m/s] of a velocity that a page gives
MAX_RATE = 10_000.0  # [1/s] steps per second
MAX_NUMBER = 2**53  # of a command, which JavaScript counts
ALL = -1  # stands for all shepherds, or for none


@dataclass(frozen=True)
class CommandField:
    """A field of a command: an example, by which its type is known, and limits."""

    example: Any
    doc: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    optional: bool = False

    def about(self) -> dict[str, Any]:
        """Return the field as plain data."""
        kind = type(self.example).__name__
        limits = {'low': self.low, 'high': self.high, 'choices': list(self.choices)}
        bounds = {key: value for key, value in limits.items() if value not in (None, [])}
        return {'type': kind, 'doc': self.doc, 'optional': self.optional, **bounds}


@dataclass(frozen=True)
class CommandKind:
    """A command by its name."""

    doc: str
    fields: Mapping[str, CommandField] = field(default_factory=dict)


@dataclass(frozen=True)
class ConsoleCommand:
    """A command that a page gave, with values of the fields of its kind."""

    name: str
    values: Mapping[str, Any]
    number: int | None = None  # which the answer repeats


class CommandError(ConfigError):
    """A text that is no command, with the number that it has given itself."""

    def __init__(self, text: str, number: int | None = None) -> None:
        """Take what is wrong."""
        super().__init__(text)
        self.number = number


def _shepherd(doc: str, optional: bool = False) -> CommandField:
    return CommandField(0, doc, 0, MAX_SHEPHERDS - 1, optional=optional)


def _metres(doc: str) -> CommandField:
    return CommandField(0.0, doc, -MAX_FLOAT32, MAX_FLOAT32)


_BAG = {
    'bag': CommandField('bag', 'name of a bag, as message `bags` lists it'),
    'episode': CommandField(0, 'which episode of the bag, counted from 0', 0, optional=True),
}
COMMAND_KINDS: dict[str, CommandKind] = {
    'ack': CommandKind(
        'the frame of this number is drawn; at most two frames are on their way',
        {'frame': CommandField(0, 'number of the frame', 0, 2**32 - 1)},
    ),
    'watch': CommandKind(
        'send ranges of the lidar of a shepherd',
        {'shepherd': CommandField(0, 'its index; -1: of none', ALL, MAX_SHEPHERDS - 1)},
    ),
    'pause': CommandKind('pause the world'),
    'resume': CommandKind('let the world go on'),
    'step': CommandKind(
        'make steps, then pause', {'steps': CommandField(1, 'how many', 1, 1_000_000)}
    ),
    'reset': CommandKind(
        'begin the next episode',
        {'seed': CommandField(0, 'its seed', -MAX_SEED, MAX_SEED, optional=True)},
    ),
    'rate': CommandKind(
        'set the pace',
        {'rate': CommandField(1.0, 'steps per second; 0: that of the world', 0.0, MAX_RATE)},
    ),
    'settings': CommandKind(
        'set parameters of the next episode',
        {'values': CommandField({'n_sheep': 100}, 'values by name, as message `world` has them')},
    ),
    'goal': CommandKind('move the goal', {'x': _metres('x [m]'), 'y': _metres('y [m]')}),
    'driver': CommandKind(
        'let a source of commands drive a shepherd',
        {
            'shepherd': CommandField(0, 'its index; -1: all', ALL, MAX_SHEPHERDS - 1),
            'source': CommandField('policy', 'name of a source, as message `drivers` lists it'),
        },
    ),
    'lock': CommandKind(
        'lock a shepherd or all: zero is published while it is locked',
        {
            'locked': CommandField(True, 'whether it is locked'),
            'shepherd': CommandField(
                0, 'its index; -1 or none: all', ALL, MAX_SHEPHERDS - 1, optional=True
            ),
        },
    ),
    'drive': CommandKind(
        'take a shepherd and drive it; it stops 100 ms after the last, is released after 0.5 s',
        {
            'shepherd': _shepherd('its index'),
            'x': CommandField(0.0, 'velocity [m/s]', -MAX_SPEED, MAX_SPEED),
            'y': CommandField(0.0, 'velocity [m/s]', -MAX_SPEED, MAX_SPEED),
            'frame': CommandField(
                'world', 'world, or body: x is forward, y is left', choices=('world', 'body'),
                optional=True,
            ),
        },
    ),
    'release': CommandKind(
        'stop a shepherd that this page drives and give it back',
        {'shepherd': _shepherd('its index; without it all of them', optional=True)},
    ),
    'blur': CommandKind('the page is hidden or has lost focus: stop and give back what it drives'),
    'record': CommandKind('record into a new bag'),
    'stop_recording': CommandKind('finish the bag'),
    'list_bags': CommandKind('list the bags of the folder; message `bags` has them'),
    'replay': CommandKind('read an episode of a bag; message `job` says where it is', _BAG),
    'counterfactual': CommandKind(
        'let another controller drive on from a step of a recorded episode',
        {
            **_BAG,
            'step': CommandField(0, 'step to go on from', 0),
            'controller': CommandField('strombom', 'controller, or policy:CHECKPOINT'),
        },
    ),
    'cancel': CommandKind(
        'end a job', {'job': CommandField(1, 'number of the job, as message `job` has it', 0)}
    ),
    'value_map': CommandKind(
        'show the values that a critic gives to places of a shepherd, until it is turned off',
        {
            'on': CommandField(True, 'whether it is shown'),
            'checkpoint': CommandField(
                'strombom', 'checkpoint: a file, or the name of one that is shipped', optional=True
            ),
            'shepherd': _shepherd('whose places', optional=True),
        },
    ),
}  # fmt: skip


def parse_command(text: str | bytes) -> ConsoleCommand:
    """Return the command of a text, or raise CommandError that says what is wrong with it."""
    number = None
    try:
        if isinstance(text, bytes):
            raise ConfigError(f'a message of {len(text)} bytes: expected a JSON text')
        data = dict(mapping('command', json.loads(text)))
        given = data.pop('id', None)
        if given is not None:
            number = checked('id', given, 0, {'low': 0, 'high': MAX_NUMBER})
        name = data.pop('do', None)
        if not isinstance(name, str) or name not in COMMAND_KINDS:
            raise unknown_name('do', name, list(COMMAND_KINDS))
        return ConsoleCommand(name, _fields_of(name, data), number)
    except ConfigError as error:
        raise CommandError(str(error), number) from None
    except (ValueError, RecursionError) as error:
        raise CommandError(
            f'command {text[:60]!r} cannot be read ({error!r:.80}): expected JSON such as '
            '{"do": "pause"}'
        ) from None


def _fields_of(name: str, data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a command, those that it may lack only if they are there."""
    fields = COMMAND_KINDS[name].fields
    for key in data.keys() - fields.keys():
        raise unknown_name(f'field of {name}', key, sorted(fields) or ['none'])
    values = {}
    for key, about in fields.items():
        if data.get(key) is None:
            if not about.optional:
                raise ConfigError(f'{name} lacks {key}: expected {about.doc}')
            continue
        limits = {'low': about.low, 'high': about.high, 'choices': about.choices}
        values[key] = checked(key, data[key], about.example, limits)
        if isinstance(values[key], str) and len(values[key]) > MAX_TEXT:
            raise ConfigError(f'{key} has {len(values[key])} characters: expected {MAX_TEXT}')
    return values
