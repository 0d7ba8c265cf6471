"""The latched description of an episode: JSON that conforms to msg_schemas/episode.schema.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import json
from typing import Any

from shepherd_ros import __version__
from shepherd_ros.config import checked, ConfigError, mapping
from shepherd_ros.sim.limits import MAX_DT, MAX_SHEEP, MAX_SHEPHERDS, MAX_STEPS, MIN_DT

SCHEMA = 1
MODES = ('lockstep', 'realtime')
SECOND = 1_000_000_000  # [ns]
INT64 = {'low': -(2**63), 'high': 2**63 - 1}
FIELDS: dict[str, tuple[Any, dict[str, Any]]] = {  # an example and the limits
    'number': (0, INT64),
    'seed': (0, INT64),
    'n_sheep': (100, {'low': 1, 'high': MAX_SHEEP}),
    'n_shepherds': (3, {'low': 1, 'high': MAX_SHEPHERDS}),
    'goal_radius': (4.0, {'low': 0.0}),
    'frame_id': ('map', {}),
    'mode': ('lockstep', {'choices': MODES}),
    'version': (__version__, {}),
}
START = {'sec': (0, {'low': 0, 'high': 2**32}), 'nanosec': (0, {'low': 0, 'high': SECOND - 1})}
WORLD = {
    'dt': (0.5, {'low': MIN_DT, 'high': MAX_DT}),
    'episode_steps': (1000, {'low': 1, 'high': MAX_STEPS}),
}


@dataclass(frozen=True)
class Episode:
    """What every node needs to know of the running episode."""

    number: int  # counted from 0 since flock_sim started
    seed: int
    start_ns: int  # stamp of the first state
    n_sheep: int
    n_shepherds: int
    goal_radius: float  # m
    frame_id: str
    mode: str
    world: Mapping[str, Any]  # plain data: what WorldConfig.to_dict() gives
    version: str = __version__

    @property
    def dt(self) -> float:
        """Return the time between two states [s]."""
        return float(self.world['dt'])

    @property
    def dt_ns(self) -> int:
        """Return the time between two states."""
        return round(self.dt * 1e9)

    @property
    def episode_steps(self) -> int:
        """Return the step of the last state."""
        return int(self.world['episode_steps'])

    def step_of(self, stamp_ns: int) -> int:
        """Return the step of a state's stamp; outside 0 .. episode_steps it is not of this one."""
        return (stamp_ns - self.start_ns) // self.dt_ns

    def has(self, stamp_ns: int) -> bool:
        """Return whether a stamp can belong to a state of this episode."""
        return 0 <= self.step_of(stamp_ns) <= self.episode_steps

    def to_json(self) -> str:
        """Return the content of the topic."""
        data = {name: getattr(self, name) for name in FIELDS} | {
            'schema': SCHEMA,
            'start': {'sec': self.start_ns // SECOND, 'nanosec': self.start_ns % SECOND},
            'world': dict(self.world),
        }
        return json.dumps(data, sort_keys=True)

    @classmethod
    def from_json(cls, text: str, **defaults: Any) -> Episode:
        """
        Return the episode, or raise ConfigError that says what is wrong with the text.

        defaults are values of what may be missing. Of the world only what all readers need is
        checked, the rest by WorldConfig.from_dict().
        """
        try:
            data = {**defaults, **mapping('episode', json.loads(text))}
            if data['schema'] != SCHEMA:
                raise ConfigError(f'schema is {data["schema"]}: expected {SCHEMA}')
            about = _read(data, FIELDS)
            start = _read(mapping('start', data['start']), START)
            world = dict(mapping('world', data['world']))
            return cls(
                start_ns=start['sec'] * SECOND + start['nanosec'],
                world=world | _read(world, WORLD),
                **about,
            )
        except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
            why = str(error) if isinstance(error, ConfigError) else f'{error!r:.80}'
            raise ConfigError(
                f'episode {text[:60]!r} cannot be read ({why}): expected JSON as in '
                'msg_schemas/episode.schema.json'
            ) from error


def _read(data: Mapping[str, Any], fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return some fields of data; raises KeyError and ConfigError."""
    return {name: checked(name, data[name], *about) for name, about in fields.items()}
