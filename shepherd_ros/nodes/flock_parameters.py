"""The parameters of flock_sim that make the world, and changes of others while it runs."""

from __future__ import annotations

from dataclasses import replace

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from shepherd_ros.config import ConfigError
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.ros.parameters import declare_config
from shepherd_ros.sim.flocking import FLOCK_MODELS
from shepherd_ros.sim.presets import PRESETS, world_preset
from shepherd_ros.sim.world import WorldConfig

LOWEST_RATE = 0.001  # [1/s]


def declare_world(node: ShepherdNode) -> WorldConfig:
    """Declare all parameters of the world; the preset gives the defaults."""
    models, presets = tuple(sorted(FLOCK_MODELS)), tuple(sorted(PRESETS))
    doc = 'flock model: ' + ', '.join(models)
    flock = node.option('flock', 'strombom', doc, choices=models)
    doc = 'defaults of dt and flock: ' + ', '.join(presets)
    preset = node.option('preset', 'default', doc, choices=presets)
    world = world_preset(preset, flock)
    flocks = {
        name: declare_config(node, world_preset(preset, name).flock, f'{name}.') for name in models
    }
    start = declare_config(node, world.spawn, 'spawn.')
    return declare_config(node, replace(world, spawn=start, flock=flocks[flock]))


def check_rate(rate: float) -> None:
    """Refuse a rate at which no step would be made in a quarter of an hour."""
    if 0 < rate < LOWEST_RATE:
        raise ConfigError(
            f'rate is {rate}: expected 0, or at least {LOWEST_RATE} steps per second'
        )


def check_changes(parameters: list[Parameter]) -> SetParametersResult:
    """Return whether new values can be taken; rclpy has checked their types and ranges."""
    try:
        for parameter in parameters:
            if parameter.name == 'rate':
                check_rate(parameter.value)
    except ConfigError as error:
        return SetParametersResult(successful=False, reason=str(error))
    return SetParametersResult(successful=True)
