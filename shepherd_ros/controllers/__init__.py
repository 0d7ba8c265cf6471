"""
Controllers: perceived state in, shepherd velocities out. Each module adds its own to CONTROLLERS.

A controller of your own is one file with a subclass of Controller, here or in a plug-in; the
runner, the demo and the nodes then know it by its name.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules
from typing import Any

from shepherd_ros.controllers.controller import Controller, CONTROLLERS
from shepherd_ros.sim.world import WorldConfig

__all__ = [
    'composite',
    'controller',
    'Controller',
    'CONTROLLERS',
    'make_controller',
    'policy_controller',
]

for info in iter_modules(__path__):
    import_module(f'{__name__}.{info.name}')


def make_controller(name: str, world: WorldConfig, **options: Any) -> Controller:
    """Return a controller for a world, with options of its own configuration."""
    kind = CONTROLLERS[name]
    return kind(kind.config_type(**options), world)
