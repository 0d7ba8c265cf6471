"""The parameters of flock_sim that make the world."""

from __future__ import annotations

from dataclasses import replace

from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.ros.parameters import declare_config
from shepherd_ros.sim.flocking import FLOCK_MODELS
from shepherd_ros.sim.presets import PRESETS, world_preset
from shepherd_ros.sim.world import WorldConfig


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
