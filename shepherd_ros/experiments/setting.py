"""One setting of an experiment: everything that decides its episodes but who drives."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from shepherd_ros.config import Config, ConfigError, option
from shepherd_ros.sim.flocking.strombom import StrombomFlock
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.presets import world_preset
from shepherd_ros.sim.rollout import EnvConfig

SCATTER = 5.0  # [m] standard deviation of the start `scattered`; the paper has 1
STARTS: dict[str, dict[str, Any]] = {
    'paper': {},
    'scattered': {'position_std': SCATTER},
    'two_groups': {'flock_groups': 2},
}


@dataclass(frozen=True)
class Setting(Config):
    """A world of section 5 of the paper, with what an experiment may change of it."""

    sheep: int = option(100, 'sheep', low=1)
    shepherds: int = option(3, 'shepherds', low=1)
    flock: str = option('strombom', 'flock model')
    preset: str = option('default', 'named setting of time step and flock')
    noise: float = option(0.0, 'noise on all perceived positions [m]', low=0.0)
    repulsion: float = option(0.0, 'rho_a; 0: that of the preset', low=0.0)
    start: str = option('paper', 'where agents start', choices=tuple(STARTS))
    dropout: float = option(0.0, 'chance that a ray returns nothing', low=0.0, high=1.0)
    rays: int = option(512, 'rays of the lidar; a policy sees each several times', low=4)
    cross_occlusion: bool = option(False, 'sheep and shepherds hide what is behind')
    any_dt: bool = option(False, 'a policy flies at another time step than it was trained for')
    steps: int = option(1000, 'steps of an episode', low=1)


# any_dt is a leave and no property of the episodes
FIELDS = tuple(f.name for f in fields(Setting) if f.name != 'any_dt')
_TEXTS = {
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


def describe(setting: Setting) -> str:
    """Return in words how a setting differs from the default one."""
    base = settled(Setting(preset=setting.preset, flock=setting.flock))
    plain = Setting()
    words = [
        text.format(getattr(setting, name))
        for name, text in _TEXTS.items()
        if getattr(setting, name) != getattr(plain if name in ('preset', 'flock') else base, name)
    ]
    return ', '.join(words) or 'default setting'


def settled(setting: Setting) -> Setting:
    """Return the setting with the repulsion that its flock has, or raise ConfigError."""
    flock = world_preset(setting.preset, setting.flock).flock
    if isinstance(flock, StrombomFlock):
        return replace(setting, repulsion=setting.repulsion or flock.sheep_repulsion)
    if setting.repulsion:
        raise ConfigError(
            f'repulsion is {setting.repulsion}: expected 0, as the {setting.flock} flock has no '
            'rho_a'
        )
    return setting


def env_config(setting: Setting) -> EnvConfig:
    """Return the environment of a setting, or raise ConfigError; its lidar has the faults."""
    world = world_preset(setting.preset, setting.flock)
    flock = world.flock
    if isinstance(flock, StrombomFlock):
        flock = replace(flock, sheep_repulsion=settled(setting).repulsion)
    else:
        settled(setting)
    world = replace(
        world,
        n_sheep=setting.sheep,
        n_shepherds=setting.shepherds,
        episode_steps=setting.steps,
        flock=flock,
        spawn=replace(world.spawn, **STARTS[setting.start]),
    )
    lidar = LidarConfig(
        n_rays=setting.rays,
        dropout=setting.dropout,
        cross_occlusion=setting.cross_occlusion,
    )
    return EnvConfig(noise_std=setting.noise, world=world, lidar=lidar)
