"""Which processes make a running stack, for the demo, the launch file and benchmarks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


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
