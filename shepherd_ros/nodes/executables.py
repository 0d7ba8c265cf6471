"""
The main functions of executables by name.

The imports of one take seconds, in which Ctrl-C ends it at once and without a traceback.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
import signal
import sys

FILES = {  # of all executables but those of single controllers
    'flock_sim': 'flock_node',
    'lidar': 'lidar_node',
    'metrics': 'metrics_node',
    'herd': 'herd_node',
    'mux': 'mux_node',
    'player': 'player_node',
    'recorder': 'recorder_node',
    'controller': 'heuristic_node',
    'policy': 'policy_node',
    'console': 'console_node',
    'foxglove': 'foxglove_node',
}


def names() -> list[str]:
    """Return the names of all executables."""
    from shepherd_ros.controllers import CONTROLLERS  # with torch, which takes a second

    return sorted({*FILES, *(kind.executable for kind in CONTROLLERS.values())})


def __getattr__(name: str) -> Callable[[], int]:
    """Return the main function of an executable; its file is imported when it is called."""
    if name.startswith('_'):
        raise AttributeError(name)

    def main() -> int:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # until the node has handlers of its own
        try:
            file = import_module(f'shepherd_ros.nodes.{FILES.get(name, "heuristic_node")}')
        except ModuleNotFoundError as error:
            from shepherd_ros.resources import missing_package  # setup.py runs this file alone

            print(f'{name}: {missing_package(error)}', file=sys.stderr)
            return 2
        return int((file.main if name in FILES else getattr(file, name))())

    return main
