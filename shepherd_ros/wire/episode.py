"""The latched description of an episode: JSON that conforms to msg_schemas/episode.schema.json."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass, field
import json
import math
import re
from typing import Any

from shepherd_ros import __version__
from shepherd_ros.config import checked, ConfigError, mapping, unknown_name
from shepherd_ros.sim.limits import (
    MAX_DT,
    MAX_FLOAT32,
    MAX_SHEEP,
    MAX_SHEPHERDS,
    MAX_STEPS,
    MIN_DT,
)

SCHEMA = 1
MODES = ('lockstep', 'realtime')
ENDS = ('terminated', 'truncated')
_NS_PER_SECOND = 1_000_000_000  # [ns]
INT64 = 2**63 - 1
EPISODE_FIELDS: dict[str, tuple[Any, dict[str, Any]]] = {  # an example and the limits
    'number': (0, {'low': 0, 'high': INT64}),
    'seed': (0, {'low': -INT64 - 1, 'high': INT64}),
    'n_sheep': (100, {'low': 1, 'high': MAX_SHEEP}),
    'n_shepherds': (3, {'low': 1, 'high': MAX_SHEPHERDS}),
    'goal_radius': (4.0, {'low': math.ulp(0.0), 'high': MAX_FLOAT32}),
    'frame_id': ('map', {}),
    'mode': ('lockstep', {'choices': MODES}),
    'version': (__version__, {}),
}
START = {
    'sec': (0, {'low': 0, 'high': 2**31 - 1}),
    'nanosec': (0, {'low': 0, 'high': _NS_PER_SECOND - 1}),
}
WORLD = {
    'dt': (0.5, {'low': MIN_DT, 'high': MAX_DT}),
    'episode_steps': (1000, {'low': 1, 'high': MAX_STEPS}),
}


@dataclass(frozen=True)
class Episode:
    """Description of the running episode that every node reads."""

    number: int  # counted from 0 since flock_sim started
    seed: int
    start_ns: int  # stamp of the first state
    n_sheep: int
    n_shepherds: int
    goal_radius: float  # m
    frame_id: str
    mode: str
    world: Mapping[str, Any]  # plain data, as of WorldConfig.to_dict()
    version: str = __version__
    end: str = field(default='', compare=False)  # of ENDS once it is over, '' where time ends all

    @property
    def dt(self) -> float:
        """Return the time between two states [s]."""
        return float(self.world['dt'])

    @property
    def dt_ns(self) -> int:
        """Return the time between two states [ns]."""
        return round(self.dt * 1e9)

    @property
    def episode_steps(self) -> int:
        """Return the step of the last state."""
        return int(self.world['episode_steps'])

    @property
    def task(self) -> str:
        """Return the name of the task of the team."""
        return str(mapping('task', self.world.get('task', {})).get('name', 'herding'))

    @property
    def goal_moves(self) -> bool:
        """Return whether the goal moves by itself, and is published with each state."""
        return bool(self.world.get('goal_speed', 0.0) > 0)

    def step_of(self, stamp_ns: int) -> int:
        """Return the step of a stamp [ns]; outside 0 .. episode_steps: of another episode."""
        return (stamp_ns - self.start_ns) // self.dt_ns

    def has(self, stamp_ns: int) -> bool:
        """Return whether a stamp can belong to a state of this episode."""
        return 0 <= self.step_of(stamp_ns) <= self.episode_steps

    def to_json(self) -> str:
        """Return the content of the topic, JSON."""
        data = {name: getattr(self, name) for name in EPISODE_FIELDS} | {
            'schema': SCHEMA,
            'start': {
                'sec': self.start_ns // _NS_PER_SECOND,
                'nanosec': self.start_ns % _NS_PER_SECOND,
            },
            'world': dict(self.world),
        }
        data |= {'end': self.end} if self.end else {}
        return json.dumps(data, sort_keys=True)

    @classmethod
    def from_json(cls, text: str, **defaults: Any) -> Episode:
        """
        Return the episode, or raise ConfigError with the fault of the text.

        defaults are values of fields that may be missing. Of the world only the fields in WORLD
        are checked, the rest by WorldConfig.from_dict().
        """
        try:
            data = mapping('episode', json.loads(text))
            _expect(data, EPISODE_FIELDS.keys() | {'schema', 'start', 'world', 'end'})
            if data['schema'] is True or data['schema'] != SCHEMA:
                raise ConfigError(f'schema is {data["schema"]!r}: expected {SCHEMA}')
            present = {
                n: EPISODE_FIELDS[n] for n in EPISODE_FIELDS if n in data or n not in defaults
            }
            present |= {'end': ('terminated', {'choices': ENDS})} if 'end' in data else {}
            values = defaults | _read(data, present)
            start = _read(_expect(mapping('start', data['start']), START.keys()), START)
            world = dict(mapping('world', data['world']))
            world |= _read(world, WORLD)
            if not (
                values['frame_id'] and re.match('[0-9]+[.][0-9]+[.][0-9]+', values['version'])
            ):
                raise ConfigError('frame_id or version is empty: expected names')
            return cls(
                start_ns=start['sec'] * _NS_PER_SECOND + start['nanosec'], world=world, **values
            )
        except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
            reason = str(error) if isinstance(error, ConfigError) else repr(error)
            raise ConfigError(
                f'episode {text[:60]!r} cannot be read ({reason:.200}): expected JSON as in '
                'msg_schemas/episode.schema.json'
            ) from error


def _expect(data: Mapping[str, Any], names: Set[str]) -> Mapping[str, Any]:
    """Return data if it has no other names, else raise ConfigError."""
    for name in data.keys() - names:
        raise unknown_name('field', name, sorted(names))
    return data


def _read(data: Mapping[str, Any], fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return some fields of data; raises KeyError and ConfigError."""
    return {name: checked(name, data[name], *limits) for name, limits in fields.items()}
