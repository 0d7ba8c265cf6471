"""The parameters of flock_sim for its world, and changes of others while it runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from shepherd_ros.config import ConfigError, unknown_name
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.ros.parameters import declare_config, present_config
from shepherd_ros.sim.flocking import FLOCK_MODELS
from shepherd_ros.sim.presets import PRESETS, world_preset
from shepherd_ros.sim.tasks import TASKS
from shepherd_ros.sim.tasks.herding import Herding
from shepherd_ros.sim.world import WorldConfig

LOWEST_RATE = 0.001  # [1/s]


class WorldParameters:
    """
    The parameters of the world: what they are now holds from the next episode on.

    The preset gives the defaults. Another preset gives its own to those that have the default of
    the one before, and leaves the others as the user has set them.
    """

    def __init__(self, node: ShepherdNode) -> None:
        """Declare them all."""
        self.node = node
        models, presets = tuple(sorted(FLOCK_MODELS)), tuple(sorted(PRESETS))
        tasks = tuple(sorted(TASKS))
        doc = 'what the team has to do, with defaults of the world: ' + ', '.join(tasks)
        self.task: str = node.option('task', Herding.name, doc, choices=tasks)
        doc = 'flock model: ' + ', '.join(models)
        own = TASKS[self.task].flock
        flock = node.option('flock', own, doc, read_only=False, choices=models)
        doc = 'defaults of dt and flock: ' + ', '.join(presets)
        self.preset = node.option('preset', 'default', doc, read_only=False, choices=presets)
        self.world = world_preset(self.preset, flock, self.task)
        self.flocks = {
            name: world_preset(self.preset, name).flock for name in models
        }  # of the preset, with the names and kinds of all options
        for name, config in self.flocks.items():
            declare_config(node, config, f'{name}.', read_only=False)
        for name, kind in TASKS.items():
            declare_config(node, kind(), f'{name}.', read_only=False)
        declare_config(node, self.world.spawn, 'spawn.', read_only=False)
        declare_config(node, self.world, read_only=False)

    def present(self, changes: Mapping[str, Any] = MappingProxyType({})) -> WorldConfig:
        """Return the world as the parameters are now, or would be with changes by name."""
        changes = self.following(changes) | dict(changes)
        flock = changes['flock'] if 'flock' in changes else self.node.get_parameter('flock').value
        if flock not in self.flocks:
            raise unknown_name('flock', flock, list(self.flocks))
        spawn = present_config(self.node, self.world.spawn, 'spawn.', changes)
        own = present_config(self.node, self.flocks[flock], f'{flock}.', changes)
        task = present_config(self.node, self.world.task, f'{self.task}.', changes)
        world = replace(self.world, spawn=spawn, flock=own, task=task)
        return present_config(self.node, world, '', changes)

    def following(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values that parameters get by a change of the preset, by name."""
        preset = changes.get('preset', self.preset)
        if preset == self.preset:
            return {}
        before, after = _defaults(self.preset), _defaults(preset)
        return {
            name: value
            for name, value in after.items()
            if name not in changes and self.node.get_parameter(name).value == before[name]
        }

    def take(self, preset: str) -> None:
        """Set the parameters that follow from another preset."""
        followers = self.following({'preset': preset})
        self.preset = preset
        self.node.set_parameters([Parameter(n, value=value) for n, value in followers.items()])


def _defaults(preset: str) -> dict[str, Any]:
    """Return the parameters that a preset gives, by name."""
    found: dict[str, Any] = {}
    for name in FLOCK_MODELS:
        world = world_preset(preset, name)
        found |= {f'{name}.{path}': value for path, value in world.flock.values().items()}
        found['dt'] = world.dt
    return found


def declare_rate(node: ShepherdNode) -> float:
    """Declare the steps per second and return them."""
    rate: float = node.option(
        'rate', 0.0, 'steps per second of wall time, in lockstep at most; 0: 1/dt in realtime, '
        'any in lockstep', read_only=False, low=0.0, high=10_000.0,
    )  # fmt: skip
    check_rate(rate)
    return rate


def check_rate(rate: float) -> None:
    """Raise ConfigError for a rate of less than a step in a quarter of an hour."""
    if 0 < rate < LOWEST_RATE:
        raise ConfigError(
            f'rate is {rate}: expected 0, or at least {LOWEST_RATE} steps per second'
        )


def check_changes(world: WorldParameters, parameters: list[Parameter]) -> SetParametersResult:
    """Return whether new values can be taken; rclpy has checked their types and ranges."""
    changes = {parameter.name: parameter.value for parameter in parameters}
    try:
        check_rate(changes.get('rate', 0.0))
        world.present(changes)
    except ConfigError as error:
        return SetParametersResult(successful=False, reason=str(error))
    return SetParametersResult(successful=True)
