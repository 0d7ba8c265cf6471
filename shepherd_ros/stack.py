"""Which processes make a running stack, for the demo, the launch file and benchmarks."""

from __future__ import annotations

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
        Process(controller, controller),
    ]


# name -> default and description; empty means that the node's own default holds
LAUNCH_ARGUMENTS: dict[str, tuple[str, str]] = {
    'controller': ('strombom', 'strombom, pierson, idle or random'),
    'n_sheep': ('100', 'sheep in the flock'),
    'n_shepherds': ('3', 'shepherds, each with its lidar'),
    'flock': ('strombom', 'flock model: strombom or reynolds'),
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
        try:
            return kind(given[name])
        except ValueError:
            raise ConfigError(
                f'{name} is {given[name]!r}: expected {kind.__name__}, such as '
                f'{LAUNCH_ARGUMENTS[name][0]}'
            ) from None

    if given['rviz'] not in ('true', 'false'):
        raise ConfigError(f'rviz is {given["rviz"]!r}: expected true or false')
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
        rviz=given['rviz'] == 'true',
    )
