"""
Controllers: perceived state in, shepherd velocities out. Each module with CONTROLLER is one.

A controller of your own is one new file here, with a subclass of Controller; the runner, the demo
and the controller nodes then know it by its name.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules
from typing import Any

from shepherd_ros.config import unknown_name
from shepherd_ros.controllers.base import Controller
from shepherd_ros.sim.world import WorldConfig

CONTROLLERS: dict[str, type[Controller]] = {
    controller.name: controller
    for info in iter_modules(__path__)
    for controller in [getattr(import_module(f'{__name__}.{info.name}'), 'CONTROLLER', None)]
    if controller is not None
}


def controller_type(name: str) -> type[Controller]:
    """Return the controller class of that name, or raise ConfigError."""
    if name not in CONTROLLERS:
        raise unknown_name('controller', name, sorted(CONTROLLERS))
    return CONTROLLERS[name]


def make_controller(name: str, world: WorldConfig, **options: Any) -> Controller:
    """Return a controller for a world, with options of its own configuration."""
    kind = controller_type(name)
    return kind(kind.config_type(**options), world)
