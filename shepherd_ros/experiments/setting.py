"""
A setting of an experiment: its environment, without the controller.

It is a base (a preset, a flock model, a start) and changes of its environment by path, such as
`world.dt=0.2`; frequent ones have a short name. Command lines are made of it, so torch is imported
only with an environment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, TYPE_CHECKING

from shepherd_ros.config import Config, ConfigError, option

if TYPE_CHECKING:
    from shepherd_ros.sim.rollout import EnvConfig

SCATTERED_STD = 5.0  # [m] standard deviation of the start `scattered`; the paper has 1
STARTS: dict[str, dict[str, Any]] = {
    'paper': {},
    'scattered': {'world.spawn.position_std': SCATTERED_STD},
    'two_groups': {'world.spawn.flock_groups': 2},
}


def named(path: str, default: Any, doc: str) -> Any:
    """Return a field that is a short name of an option of the environment."""
    return field(default=default, metadata={'doc': doc, 'path': path})


@dataclass(frozen=True)
class Setting(Config):
    """A world of section 5 of the paper, with the changes of an experiment."""

    task: str = option('herding', 'what the team has to do; a wrong one shows all of them')
    sheep: int = named('world.n_sheep', -1, 'sheep in the flock; -1: of the task, 100 in herding')
    shepherds: int = named('world.n_shepherds', 3, 'shepherds, each with its lidar')
    flock: str = option('', 'flock model; empty: of the task, strombom in herding')
    preset: str = option('default', 'named setting of time step and flock')
    noise: float = named('noise_std', 0.0, 'noise on all perceived positions [m]')
    repulsion: float = named('world.flock.', 0.0, 'rho_a of the flock; 0: that of the preset')
    start: str = option('paper', 'where agents start', choices=tuple(STARTS))
    dropout: float = named('lidar.dropout', 0.0, 'chance that a ray returns nothing')
    rays: int = named('lidar.n_rays', 512, 'rays of the lidar; a policy sees each several times')
    cross_occlusion: bool = named(
        'lidar.cross_occlusion', False, 'sheep and shepherds hide what is behind'
    )
    steps: int = named('world.episode_steps', 1000, 'steps of an episode')
    set: tuple[str, ...] = option(
        (), 'PATH=VALUE: any option of the environment, such as world.spawn.flock_groups=2'
    )

    def __post_init__(self) -> None:
        """Fill in what the task says."""
        super().__post_init__()
        if self.sheep == -1 or not self.flock:
            sheep, flock = of_task(self.task)
            object.__setattr__(self, 'sheep', sheep if self.sheep == -1 else self.sheep)
            object.__setattr__(self, 'flock', self.flock or flock)

    def in_task(self, task: str, fixed: Sequence[str] = ()) -> Setting:
        """Return the setting in a task: what this one has of its own task is that of the other."""
        sheep, flock = of_task(self.task)
        return replace(
            self,
            task=task,
            sheep=-1 if self.sheep == sheep and 'sheep' not in fixed else self.sheep,
            flock='' if self.flock == flock and 'flock' not in fixed else self.flock,
        )

    @classmethod
    def blank(cls) -> Setting:
        """Return the setting before the task fills in what a command line does not say."""
        setting = cls()
        for name in ('sheep', 'flock'):
            object.__setattr__(setting, name, getattr(cls, name))
        return setting


def of_task(task: str) -> tuple[int, str]:
    """Return the number of sheep and the flock model of a task, or raise ConfigError."""
    if task == 'herding':  # without torch
        return 100, 'strombom'
    from shepherd_ros.sim.presets import world_preset
    from shepherd_ros.sim.tasks import TASKS

    return world_preset(task=task).n_sheep, TASKS[task].flock


SETTING_FIELDS = tuple(f.name for f in fields(Setting) if f.name != 'set')
_TEXTS = {
    'task': 'task {}',
    'sheep': '{} sheep',
    'shepherds': 'team of {}',
    'flock': '{} flock',
    'preset': 'preset {}',
    'noise': 'noise {:g} m',
    'repulsion': 'rho_a {:g}',
    'start': 'start {}',
    'dropout': 'dropout {:g}',
    'rays': '{} rays',
    'cross_occlusion': 'types hide each other',
}


def describe_setting(setting: Setting) -> str:
    """Return the differences of a setting from the default one, in words."""
    base = canonical_setting(
        Setting(task=setting.task, preset=setting.preset, flock=setting.flock)
    )
    plain, of_base = Setting(), ('task', 'preset', 'flock')
    words = [
        text.format(getattr(setting, name))
        for name, text in _TEXTS.items()
        if getattr(setting, name) != getattr(plain if name in of_base else base, name)
    ]
    return ', '.join([*words, *setting.set]) or 'default setting'


def canonical_setting(setting: Setting) -> Setting:
    """Return the setting with short names as its environment has them, or raise ConfigError."""
    config = env_config(setting)
    values = config.values()
    paths = _paths(config)
    short = {name: values[path] for name, path in paths.items()}
    # a default can stand for another value, that of the preset
    covered = {path for name, path in paths.items() if short[name] != getattr(Setting, name)}
    words = tuple(word for word in setting.set if _assignment(word)[0] not in covered)
    return replace(setting, **short, set=words)


def env_config(setting: Setting) -> EnvConfig:
    """Return the environment of a setting, or raise ConfigError; its lidar has the faults."""
    base = _base(setting)
    paths, changes = _paths(base), setting.changes()
    if 'repulsion' in changes and 'repulsion' not in paths:
        raise ConfigError(
            f'repulsion is {setting.repulsion}: expected 0, as the {setting.flock} flock has no '
            'rho_a'
        )
    short = {paths[name]: value for name, value in changes.items() if name in paths}
    assigned = dict(map(_assignment, setting.set))
    return base.with_values(STARTS[setting.start] | short | assigned)


def changes_of(setting: Setting) -> dict[str, Any]:
    """Return the changes of a setting to its preset's world with its flock, by path."""
    before = _base(setting).values()
    return {p: value for p, value in env_config(setting).values().items() if value != before[p]}


def _base(setting: Setting) -> EnvConfig:
    """Return the environment of preset and flock."""
    from shepherd_ros.sim.presets import world_preset
    from shepherd_ros.sim.rollout import EnvConfig

    return EnvConfig(world=world_preset(setting.preset, setting.flock, setting.task))


def _paths(config: EnvConfig) -> dict[str, str]:
    """Return the paths of short names; that of the repulsion is up to the flock model."""
    paths = {f.name: f.metadata['path'] for f in fields(Setting) if 'path' in f.metadata}
    rho = paths.pop('repulsion') + config.world.flock.repulsion_option
    return paths | ({'repulsion': rho} if config.world.flock.repulsion_option else {})


def _assignment(word: str) -> tuple[str, str]:
    """Return path and value of PATH=VALUE, or raise ConfigError."""
    path, equals, value = word.partition('=')
    if not equals:
        raise ConfigError(f'set is {word!r}: expected PATH=VALUE, such as world.dt=0.2')
    return path.strip(), value.strip()
