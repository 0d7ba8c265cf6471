"""Which processes make a running stack, for the demo, the launch file and benchmarks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from shepherd_ros.config import ConfigError, read
from shepherd_ros.experiments.setting import changes_of, Setting, settled


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
    world, lidar, own = {}, {}, commanded(controller, n_shepherds, flock_sim)
    for path, value in (changes or {}).items():
        room, _, name = path.partition('.')
        if room == 'world':
            inner = name.removeprefix('flock.')
            world[name if inner == name else f'{model}.{inner}'] = value
        elif room in ('lidar', 'noise_std'):
            lidar[name or path] = value
        else:
            raise ConfigError(f'{path} is {value}: expected its default, as no node has it')
        if path == 'noise_std' and controller != 'policy':  # which sees with the lidars
            own[path] = value
    return [
        Process('flock_sim', 'flock_sim', {'n_shepherds': n_shepherds, **world, **flock_sim}),
        *(
            Process('lidar', f'lidar_{h}', {'shepherd_ids': [h], **lidar})
            for h in range(n_shepherds)
        ),
        Process('metrics', 'metrics'),
        controller_process(controller, own),
    ]


def controller_process(name: str, parameters: Mapping[str, Any]) -> Process:
    """Return the process of a controller, or raise ConfigError."""
    from shepherd_ros.controllers import CONTROLLERS  # with torch, which takes a second

    executable = CONTROLLERS[name].executable
    which = {} if executable == name else {'controller': name}
    return Process(executable, name, {**which, **parameters})


def stack_in(setting: Setting, controller: str, **flock_sim: Any) -> list[Process]:
    """Return the stack of a controller in a setting, or raise ConfigError."""
    setting = settled(setting)
    changes = changes_of(setting)
    flock_sim = {'flock': setting.flock, 'preset': setting.preset, **flock_sim}
    return herding_stack(controller, setting.shepherds, changes, **flock_sim)


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


# argument of the launch file -> field of the setting; an argument is called as the parameter is
_OF_SETTING = {
    f.metadata.get('path', '').rpartition('.')[2] or f.name: f
    for f in fields(Setting)
    if f.name not in ('any_dt', 'set')
}
# name -> default and description; empty means that the node's own default holds
LAUNCH_ARGUMENTS: dict[str, tuple[str, str]] = {
    'controller': ('strombom', 'a controller by its name; a wrong one shows all of them'),
    **{name: (_yaml(f.default), f.metadata['doc']) for name, f in _OF_SETTING.items()},
    'set': ('', 'other options of the environment, such as "world.dt=0.2 lidar.range_noise=0.1"'),
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
    setting: Setting
    flock_sim: dict[str, Any]
    params_file: str
    namespace: str
    rviz: bool


def launch_values(given: dict[str, str]) -> LaunchValues:
    """Return the arguments of the launch file in their types, or raise ConfigError."""
    named = {f.name: read(name, given[name], f.default) for name, f in _OF_SETTING.items()}
    return LaunchValues(
        controller=given['controller'],
        setting=settled(Setting(**named, set=tuple(given['set'].split()))),
        flock_sim={
            **{name: read(name, given[name], 0) for name in ('seed', 'episodes')},
            'mode': given['mode'],
            'rate': read('rate', given['rate'], 0.0),
        },
        params_file=given['params_file'],
        namespace=given['namespace'],
        rviz=read('rviz', given['rviz'], False),
    )


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
        read(name, given[name], float(REPLAY_ARGUMENTS[name][0])) for name in ('rate', 'delay')
    )
    words = [given['bag'], '--rate', str(rate)]
    words += ['--loop'] if read('loop', given['loop'], False) else []
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
        rviz=read('rviz', given['rviz'], False),
    )
