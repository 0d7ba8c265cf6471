"""The configuration of a world: its agents, its time and the start of an episode."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from shepherd_ros.config import Config, ConfigError, mapping, option, part
from shepherd_ros.registry import Extended
from shepherd_ros.sim.flocking import FLOCK_MODELS, model_of
from shepherd_ros.sim.flocking.flock_model import FlockConfig
from shepherd_ros.sim.flocking.strombom_flock import StrombomFlock
from shepherd_ros.sim.goal_motion import GOAL_PATHS
from shepherd_ros.sim.limits import MAX_DT, MAX_SHEEP, MAX_SHEPHERDS, MAX_STEPS, MIN_DT
from shepherd_ros.sim.tasks import Task, TASKS
from shepherd_ros.sim.tasks.herding import Herding
from shepherd_ros.sim.world_parameters import WORLD_PARAMETERS


@dataclass(frozen=True)
class SpawnConfig(Config):
    """Distribution of the agents' start; defaults of the paper, section 4, for evaluation."""

    flock_distance_min: float = option(10.0, 'goal to flock, nearest [m]', low=0.0)
    flock_distance_max: float = option(20.0, 'goal to flock, farthest [m]', low=0.0)
    shepherd_distance_min: float = option(5.0, 'flock to shepherds, nearest [m]', low=0.0)
    shepherd_distance_max: float = option(10.0, 'flock to shepherds, farthest [m]', low=0.0)
    shepherds_around: bool = option(
        False, 'each shepherd in a direction of its own from the flock, not all in one (choice)'
    )
    position_std: float = option(
        1.0, 'standard deviation of the signed distance of an agent to its group [m]', low=0.0
    )
    flock_groups: int = option(
        1, 'groups that the flock starts in, each with a center of its own (choice)', low=1
    )
    goal_radius_extra: float = option(
        0.0, 'goal radius is uniform in goal_radius + [0, this] [m]; 4 in training', low=0.0
    )
    fewest_shepherds: int = option(
        0,
        'team size is uniform in [this, n_shepherds]; 0: always n_shepherds; 1 in training',
        low=0,
    )

    def __post_init__(self) -> None:
        """Check each field and the order of the intervals."""
        super().__post_init__()
        for name in ('flock_distance', 'shepherd_distance'):
            low, high = getattr(self, f'{name}_min'), getattr(self, f'{name}_max')
            if low > high:
                raise ConfigError(f'{name}_min is {low}: expected at most {name}_max, {high}')


@dataclass(frozen=True)
class WorldConfig(Extended):
    """Everything that decides how a world starts and moves, apart from its seed."""

    registry: ClassVar = WORLD_PARAMETERS
    n_sheep: int = option(100, 'sheep in the flock, N', low=1, high=MAX_SHEEP)
    n_shepherds: int = option(3, 'shepherds, M', low=1, high=MAX_SHEPHERDS)
    dt: float = option(
        0.5, 'seconds per step (choice: the paper gives none)', low=MIN_DT, high=MAX_DT
    )
    episode_steps: int = option(1000, 'steps per episode, T', low=1, high=MAX_STEPS)
    goal_radius: float = option(4.0, 'radius of the goal region, R_g [m]', low=0.01, high=1000.0)
    shepherd_speed: float = option(1.0, 'top speed of a shepherd, v_max [m/s]', low=0.0)
    goal_speed: float = option(
        0.0, 'speed of the goal [m/s]; 0: it stands, as in the paper', low=0.0, sparse=True
    )
    goal_path: str = option(
        'straight',
        'path of a moving goal: straight to its destination, or a circle around that',
        choices=GOAL_PATHS,
        sparse=True,
    )
    goal_distance: float = option(
        20.0, 'distance of a moving goal to its destination at the start [m]', low=0.0, sparse=True
    )
    spawn: SpawnConfig = part(SpawnConfig)
    flock: FlockConfig = part(FlockConfig, StrombomFlock)
    task: Task = part(Task, Herding)

    def __post_init__(self) -> None:
        """Check each field and that a smallest team fits."""
        super().__post_init__()
        if self.spawn.fewest_shepherds > self.n_shepherds:
            raise ConfigError(
                f'fewest_shepherds is {self.spawn.fewest_shepherds}: '
                f'expected at most n_shepherds, {self.n_shepherds}'
            )

    def to_dict(self) -> dict[str, Any]:
        """Return plain nested data; the flock carries the name of its model, a task its own."""
        data = super().to_dict()
        task = {'name': self.task.name, **data.pop('task')}
        flock = {'model': model_of(self.flock).name, **data['flock']}
        return data | {'flock': flock} | self._unless_herding(task)

    def _unless_herding(self, task: dict[str, Any]) -> dict[str, Any]:
        """Return the data of a task by its field, {} for herding, which needs none."""
        return {} if self.task == Herding() else {'task': task}

    def changes(self) -> dict[str, Any]:
        """Return the values that differ from the defaults, and always the flock model's name."""
        changes = super().changes()
        changes.pop('task', None)
        flock = {'model': model_of(self.flock).name, **self.flock.changes()}
        task = {'name': self.task.name, **self.task.changes()}
        return changes | {'flock': flock} | self._unless_herding(task)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> WorldConfig:
        """Return the configuration of the data of to_dict(), or raise ConfigError."""
        values = dict(data)
        flock = dict(mapping('flock', values.pop('flock', {})))
        model = FLOCK_MODELS[flock.pop('model', 'strombom')]
        task = dict(mapping('task', values.pop('task', {})))
        kind = TASKS[task.pop('name', Herding.name)]
        world = super().from_dict(values)
        return replace(world, flock=model.config.from_dict(flock), task=kind.from_dict(task))
