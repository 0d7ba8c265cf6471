"""Processes of a running stack, for the demo, the launch file and benchmarks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from shepherd_ros.config import ConfigError
from shepherd_ros.experiments.setting import canonical_setting, changes_of, env_config, Setting

STANDBY_PRIORITY = 9  # of the first source of mux that stands by; that of the default is higher


@dataclass(frozen=True)
class Process:
    """An executable of this package with its parameters."""

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
    world, lidar = {}, {}
    for path, value in (changes or {}).items():
        room, _, name = path.partition('.')
        part, _, inner = name.partition('.')
        if room == 'world':
            own = {'flock': model, 'task': flock_sim.get('task', 'herding')}
            world[f'{own[part]}.{inner}' if part in own else name] = value
        elif room in ('lidar', 'noise_std'):
            lidar[name or path] = value
        else:
            raise ConfigError(f'{path} is {value}: expected its default, as no node has it')
    return [
        Process('flock_sim', 'flock_sim', {'n_shepherds': n_shepherds, **world, **flock_sim}),
        *(
            Process('lidar', f'lidar_{h}', {'shepherd_ids': [h], **lidar})
            for h in range(n_shepherds)
        ),
        Process('metrics', 'metrics'),
        _seeing(controller_process(controller, flock_sim), changes or {}),
    ]


def _seeing(controller: Process, changes: Mapping[str, Any]) -> Process:
    """Return a controller with the noise of its perception; a policy sees with the lidars."""
    if 'noise_std' not in changes or controller.executable == 'policy':
        return controller
    more = {'noise_std': changes['noise_std']}
    return replace(controller, parameters=controller.parameters | more)


def controller_process(word: str, flock_sim: Mapping[str, Any], **own: Any) -> Process:
    """
    Return the process of a controller by its word, or raise ConfigError.

    flock_sim are parameters of the world: a heuristic has its preset, and a policy of which the
    word names no checkpoint is that for its flock model.
    """
    from shepherd_ros.controllers import CONTROLLERS  # with torch, which takes a second
    from shepherd_ros.experiments.methods import split_name
    from shepherd_ros.sim.flocking import FLOCK_MODELS

    name, options = split_name(word)
    executable = CONTROLLERS[name].executable
    given: dict[str, Any] = {} if executable == name else {'controller': name}
    given |= options
    if name == 'policy':
        model = FLOCK_MODELS[flock_sim.get('flock', 'strombom')]
        given.setdefault('checkpoint', model.config.checkpoint)
    elif 'preset' in flock_sim:
        given['preset'] = flock_sim['preset']
    return Process(executable, name, given | own)


def with_mux(stack: Sequence[Process], standby: Sequence[Process] = ()) -> list[Process]:
    """
    Return a stack with mux between its controller, the last process, and flock_sim.

    Controllers on standby can be selected, and stand in for one that is silent. flock_sim waits
    for scans, as it may be faster than the lidars where no policy drives.
    """
    world, own = stack[0], stack[-1]
    parameters: dict[str, Any] = {'default': own.name}
    for k, process in enumerate(standby):
        if process.name in {own.name, *(before.name for before in standby[:k])}:
            raise ConfigError(f'standby has {process.name!r}: expected each controller once')
        room = f'topics.{process.name}'
        parameters |= {f'{room}.priority': STANDBY_PRIORITY - k, f'{room}.answers': True}

    def source(process: Process) -> Process:
        return replace(process, parameters=process.parameters | {'source': process.name})

    return [
        replace(world, parameters={'wait_for_scans': True} | world.parameters),
        *stack[1:-1],
        Process('mux', 'mux', parameters),
        *map(source, standby),
        source(own),
    ]


def with_console(stack: Sequence[Process], **parameters: Any) -> list[Process]:
    """
    Return a stack with a console, whose parameters are given.

    One lidar scans all shepherds, as a page may ask for more of them.
    """
    lidars = [process for process in stack if process.executable == 'lidar']
    others = [process for process in stack if process.executable != 'lidar']
    every = Process('lidar', 'lidar', lidars[0].parameters | {'shepherd_ids': [-1]})
    return [others[0], every, Process('console', 'console', parameters), *others[1:]]


def stack_in(
    setting: Setting,
    controller: str,
    *,
    mux: bool = False,
    standby: Sequence[str] = (),
    **flock_sim: Any,
) -> list[Process]:
    """
    Return the stack of a controller in a setting that it can herd in, or raise ConfigError.

    standby are controllers that mux can switch to.
    """
    setting = canonical_setting(setting)
    flock_sim = {
        'task': setting.task, 'flock': setting.flock, 'preset': setting.preset, **flock_sim
    }  # fmt: skip
    changes = _own_lidar(controller, flock_sim) | changes_of(setting)
    stack = herding_stack(controller, setting.shepherds, changes, **flock_sim)
    others = [_seeing(controller_process(word, flock_sim), changes) for word in standby]
    if others and not mux:
        raise ConfigError(f'standby is {" ".join(standby)!r}: expected none without mux')
    if len(others) > STANDBY_PRIORITY:
        raise ConfigError(f'standby has {len(others)}: expected at most {STANDBY_PRIORITY}')
    for process in (stack[-1], *others):
        if checkpoint := process.parameters.get('checkpoint'):
            _require_fit(checkpoint, setting)
    return with_mux(stack, others) if mux else stack


def _own_lidar(controller: str, flock_sim: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options by path of the lidar that a policy was trained with, if it is one."""
    from shepherd_ros.experiments.methods import loaded

    checkpoint = controller_process(controller, flock_sim).parameters.get('checkpoint')
    changes = loaded(checkpoint).config.lidar.changes() if checkpoint else {}
    # the number of rays is that of the setting: _require_fit() compares them
    return {f'lidar.{name}': value for name, value in changes.items() if name != 'n_rays'}


def _require_fit(checkpoint: str, setting: Setting) -> None:
    """Raise ConfigError unless a policy knows the task and the rays of a setting."""
    from shepherd_ros.controllers.policy_controller import require_task
    from shepherd_ros.experiments.methods import loaded

    config, policy = env_config(setting), loaded(checkpoint)
    require_task(policy, config.world)
    rays = policy.config.lidar.n_rays
    if config.lidar.n_rays != rays:
        raise ConfigError(f'rays is {config.lidar.n_rays}: expected {rays}, as in training')
