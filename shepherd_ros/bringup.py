"""Processes of a running stack, for the demo, the launch file and benchmarks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from shepherd_ros.config import ConfigError
from shepherd_ros.experiments.setting import changes_of, env_config, Setting, settled


@dataclass(frozen=True)
class Process:
    """An executable of this package with its parameters and remaps."""

    executable: str
    name: str  # unique in the stack; also the name of its node
    parameters: dict[str, Any] = field(default_factory=dict)

    def arguments(self) -> list[str]:
        """Return the words after the executable on a command line."""
        words = ['--ros-args', '-r', f'__node:={self.name}']
        for key, value in self.parameters.items():
            words += ['-p', f'{key}:={word_of(value)}']
        return words


def word_of(value: Any) -> str:
    """Return a parameter as ROS reads it on a command line."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def herding_stack(
    controller: str = 'strombom',
    n_shepherds: int = 3,
    changes: Mapping[str, Any] | None = None,
    **flock_sim: Any,
) -> list[Process]:
    """
    Return flock_sim with parameters, a lidar per shepherd, metrics and a controller.

    changes are options of the environment by path; ConfigError for those that no node has.
    """
    model = flock_sim.get('flock', 'strombom')
    world, lidar, own = {}, {}, controller_process(controller, flock_sim)
    for path, value in (changes or {}).items():
        room, _, name = path.partition('.')
        if room == 'world':
            inner = name.removeprefix('flock.')
            world[name if inner == name else f'{model}.{inner}'] = value
        elif room in ('lidar', 'noise_std'):
            lidar[name or path] = value
        else:
            raise ConfigError(f'{path} is {value}: expected its default, as no node has it')
        if path == 'noise_std' and own.executable != 'policy':  # which sees with the lidars
            own.parameters[path] = value
    return [
        Process('flock_sim', 'flock_sim', {'n_shepherds': n_shepherds, **world, **flock_sim}),
        *(
            Process('lidar', f'lidar_{h}', {'shepherd_ids': [h], **lidar})
            for h in range(n_shepherds)
        ),
        Process('metrics', 'metrics'),
        own,
    ]


def controller_process(word: str, flock_sim: Mapping[str, Any], **own: Any) -> Process:
    """
    Return the process of a controller by its word, or raise ConfigError.

    flock_sim are parameters of the world: a heuristic has its preset, and a policy of which the
    word names no checkpoint is that for its flock model.
    """
    from shepherd_ros.controllers import CONTROLLERS  # with torch, which takes a second
    from shepherd_ros.experiments.methods import parted
    from shepherd_ros.sim.flocking import FLOCK_MODELS

    name, checkpoint = parted(word)
    executable = CONTROLLERS[name].executable
    given = {} if executable == name else {'controller': name}
    if name == 'policy':
        model = FLOCK_MODELS[flock_sim.get('flock', 'strombom')]
        given['checkpoint'] = checkpoint or model.config.checkpoint
    elif 'preset' in flock_sim:
        given['preset'] = flock_sim['preset']
    return Process(executable, name, given | own)


def stack_in(setting: Setting, controller: str, **flock_sim: Any) -> list[Process]:
    """Return the stack of a controller in a setting that it can herd in, or raise ConfigError."""
    setting = settled(setting)
    changes = changes_of(setting)
    flock_sim = {'flock': setting.flock, 'preset': setting.preset, **flock_sim}
    stack = herding_stack(controller, setting.shepherds, changes, **flock_sim)
    checkpoint = stack[-1].parameters.get('checkpoint')
    if checkpoint:
        _require_fit(checkpoint, setting)
    return stack


def _require_fit(checkpoint: str, setting: Setting) -> None:
    """Raise ConfigError unless a policy knows the time step and the rays of a setting."""
    from shepherd_ros.controllers.policy_controller import require_same_world
    from shepherd_ros.experiments.methods import loaded

    config, policy = env_config(setting), loaded(checkpoint)
    require_same_world(policy, config.world)
    rays = policy.config.lidar.n_rays
    if config.lidar.n_rays != rays:
        raise ConfigError(f'rays is {config.lidar.n_rays}: expected {rays}, as in training')
