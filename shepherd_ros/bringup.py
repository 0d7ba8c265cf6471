"""Which processes make a running stack, for the demo, the launch file and benchmarks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from shepherd_ros.config import ConfigError


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
            words += ['-p', f'{key}:={_yaml(value)}']
        return words


def _yaml(value: Any) -> str:
    """Return a parameter as ROS reads it on a command line."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def herding_stack(
    controller: str = 'strombom', n_shepherds: int = 3, **flock_sim: Any
) -> list[Process]:
    """Return flock_sim with parameters, a lidar per shepherd, metrics and a controller."""
    lidars = [Process('lidar', f'lidar_{h}', {'shepherd_ids': [h]}) for h in range(n_shepherds)]
    return [
        Process('flock_sim', 'flock_sim', {'n_shepherds': n_shepherds, **flock_sim}),
        *lidars,
        Process('metrics', 'metrics'),
        controller_process(controller, commanded(controller, n_shepherds, flock_sim)),
    ]


def controller_process(name: str, parameters: Mapping[str, Any]) -> Process:
    """Return the process of a controller, or raise ConfigError."""
    from shepherd_ros.controllers import CONTROLLERS  # with torch, which takes a second

    executable = CONTROLLERS[name].executable
    which = {} if executable == name else {'controller': name}
    return Process(executable, name, {**which, **parameters})


def commanded(
    controller: str, n_shepherds: int, flock_sim: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """
    Return the parameters with which a controller commands a whole team; most need none.

    flock_sim are parameters of the world: a policy is that for its flock model, a heuristic has
    its preset.
    """
    world = flock_sim or {}
    if controller != 'policy':
        return {'preset': world['preset']} if 'preset' in world else {}
    from shepherd_ros.sim.flocking import FLOCK_MODELS  # with torch, which takes a second

    checkpoint = FLOCK_MODELS[world.get('flock', 'strombom')].config.checkpoint
    return {'shepherd_ids': list(range(n_shepherds)), 'checkpoint': checkpoint}


# name -> default and description; empty means that the node's own default holds
LAUNCH_ARGUMENTS: dict[str, tuple[str, str]] = {
    'controller': ('strombom', 'a controller by its name; a wrong one shows all of them'),
    'n_sheep': ('100', 'sheep in the flock'),
    'n_shepherds': ('3', 'shepherds, each with its lidar'),
    'flock': ('strombom', 'flock model by its name; a wrong one shows all of them'),
    'preset': ('default', 'named setting of time step and flock'),
    'mode': ('lockstep', 'lockstep or realtime'),
    'rate': ('0.0', 'realtime: steps per second of wall time; 0: 1/dt'),
    'seed': ('0', 'seed of the first episode'),
    'episodes': ('0', 'episodes to run; 0: without end'),
    'params_file': ('', 'YAML file with parameters, which win over the arguments'),
    'namespace': ('', 'namespace of all nodes'),
    'rviz': ('false', 'also start RViz: true or false'),
}


@dataclass(frozen=True)
class LaunchValues:
    """The arguments of the launch file in their types."""

    controller: str
    n_shepherds: int
    flock_sim: dict[str, Any]
    params_file: str
    namespace: str
    rviz: bool


def launch_values(given: dict[str, str]) -> LaunchValues:
    """Return the arguments of the launch file in their types, or raise ConfigError."""

    def number(name: str, kind: type) -> Any:
        return _number(name, given[name], kind, LAUNCH_ARGUMENTS[name][0])

    return LaunchValues(
        controller=given['controller'],
        n_shepherds=number('n_shepherds', int),
        flock_sim={
            **{name: number(name, int) for name in ('n_sheep', 'seed', 'episodes')},
            **{name: given[name] for name in ('flock', 'preset', 'mode')},
            'rate': number('rate', float),
        },
        params_file=given['params_file'],
        namespace=given['namespace'],
        rviz=_truth('rviz', given['rviz']),
    )


def _number(name: str, text: str, kind: type, example: str) -> Any:
    try:
        return kind(text)
    except ValueError:
        raise ConfigError(
            f'{name} is {text!r}: expected {kind.__name__}, such as {example}'
        ) from None


def _truth(name: str, text: str) -> bool:
    if text not in ('true', 'false'):
        raise ConfigError(f'{name} is {text!r}: expected true or false')
    return text == 'true'


REPLAY_ARGUMENTS: dict[str, tuple[str, str]] = {
    'bag': ('', 'folder of a bag, or one .mcap file'),
    'rate': ('1.0', 'pace; 2.0 is twice as fast'),
    'loop': ('false', 'begin anew at the end: true or false'),
    'controller': ('', 'controller that answers instead of the recorded one; empty: none does'),
    'delay': ('5.0', 'seconds that the controller gets to start before the bag is played'),
    'params_file': ('', 'YAML file with parameters of the controller'),
    'namespace': ('', 'namespace of all topics; empty: that of the recording'),
    'rviz': ('false', 'also start RViz: true or false'),
}


@dataclass(frozen=True)
class ReplayValues:
    """What the launch file starts to play a bag."""

    player: list[str]  # words of its command line
    remaps: list[tuple[str, str]]  # of the player
    delay: float  # [s] before the player is started
    controller: str
    n_shepherds: int
    params_file: str
    namespace: str
    rviz: bool


def replay_values(given: dict[str, str], topics: list[str]) -> ReplayValues:
    """
    Return the arguments of the launch file with what follows from the topics of the bag.

    With a controller, recorded commands are not played. Raises ConfigError.
    """
    recorded = next((n.removesuffix('/episode') for n in topics if n.endswith('/episode')), '')
    space = given['namespace'].strip('/')
    remaps = [
        (name, f'/{space}{name.removeprefix(recorded)}')
        for name in topics
        if space and name.startswith(f'{recorded}/') and name not in ('/clock', '/diagnostics')
    ]
    rate, delay = (
        _number(name, given[name], float, REPLAY_ARGUMENTS[name][0]) for name in ('rate', 'delay')
    )
    words = [given['bag'], '--rate', str(rate)]
    words += ['--loop'] if _truth('loop', given['loop']) else []
    commands = [name for name in topics if name.endswith('/cmd_vel')]
    if given['controller']:
        words += ['--topics', *(name for name in topics if name not in commands)]
    return ReplayValues(
        player=words,
        remaps=remaps,
        delay=delay if given['controller'] else 0.0,
        controller=given['controller'],
        n_shepherds=len(commands),
        params_file=given['params_file'],
        namespace=space or recorded.strip('/'),
        rviz=_truth('rviz', given['rviz']),
    )
