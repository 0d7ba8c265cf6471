"""
Tasks of a team. Every module of this folder adds its own to TASKS, as a plug-in does.

A task of your own is one file with a subclass of Task: how its episodes start and end, the terms
of its reward, its metrics, and the defaults of its world and of its training. Environment, nodes,
recordings, training and command line then know it by its name.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from shepherd_ros.sim.tasks.base_task import Task, TASKS

__all__ = ['herding', 'protection', 'Task', 'TASKS']

for info in iter_modules(__path__):
    import_module(f'{__name__}.{info.name}')
