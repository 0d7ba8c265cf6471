"""The latched description of an episode: JSON that conforms to msg_schemas/episode.schema.json."""

from __future__ import annotations

from dataclasses import dataclass
import json
from typing import Any

from shepherd_ros import __version__
from shepherd_ros.config import ConfigError
from shepherd_ros.sim.world import WorldConfig

SCHEMA = 1


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
    world: WorldConfig
    version: str = __version__

    @property
    def dt_ns(self) -> int:
        """Return the time between two states."""
        return round(self.world.dt * 1e9)

    def step_of(self, stamp_ns: int) -> int:
        """Return the step of a state's stamp; outside 0 .. episode_steps it is not of this one."""
        return (stamp_ns - self.start_ns) // self.dt_ns

    def has(self, stamp_ns: int) -> bool:
        """Return whether a stamp can belong to a state of this episode."""
        return 0 <= self.step_of(stamp_ns) <= self.world.episode_steps

    def to_json(self) -> str:
        """Return the content of the topic."""
        data = {
            'schema': SCHEMA,
            'number': self.number,
            'seed': self.seed,
            'start': {'sec': self.start_ns // 10**9, 'nanosec': self.start_ns % 10**9},
            'n_sheep': self.n_sheep,
            'n_shepherds': self.n_shepherds,
            'goal_radius': self.goal_radius,
            'frame_id': self.frame_id,
            'mode': self.mode,
            'world': self.world.to_dict(),
            'version': self.version,
        }
        return json.dumps(data, sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Episode:
        """Return the episode, or raise ConfigError that says what is wrong with the text."""
        try:
            data: dict[str, Any] = json.loads(text)
            if data['schema'] != SCHEMA:
                raise ConfigError(f'episode schema is {data["schema"]}: expected {SCHEMA}')
            return cls(
                number=int(data['number']),
                seed=int(data['seed']),
                start_ns=data['start']['sec'] * 10**9 + data['start']['nanosec'],
                n_sheep=int(data['n_sheep']),
                n_shepherds=int(data['n_shepherds']),
                goal_radius=float(data['goal_radius']),
                frame_id=str(data['frame_id']),
                mode=str(data['mode']),
                world=WorldConfig.from_dict({**data['world']}),
                version=str(data['version']),
            )
        except ConfigError:
            raise
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise ConfigError(
                f'episode {text[:60]!r} cannot be read ({error!r}): expected JSON as in '
                'msg_schemas/episode.schema.json'
            ) from error
