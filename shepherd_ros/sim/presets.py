"""
Named settings of the choices that the paper leaves open: time step and range of repulsion.

The paper gives no time step, and its interaction range of 10 m makes the flock explode: see the
comments at each preset. A preset only changes defaults; every value can still be set by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from shepherd_ros.registry import Registry
from shepherd_ros.sim.flocking import FLOCK_MODELS
from shepherd_ros.sim.tasks import TASKS
from shepherd_ros.sim.tasks.herding import Herding
from shepherd_ros.sim.world import WorldConfig


@dataclass(frozen=True)
class Preset:
    """
    Changes against the default world: dt, and fields of the flock models by name.

    controllers are options of the heuristics by name.
    """

    name: str
    doc: str
    dt: float
    flock: dict[str, dict[str, Any]] = field(default_factory=dict)
    controllers: dict[str, dict[str, Any]] = field(default_factory=dict)


def _strombom(**changes: Any) -> dict[str, dict[str, Any]]:
    return {'strombom': changes}


PRESETS: Registry[Preset] = Registry('preset')
for preset in (
    Preset('default', '0.5 s, r_a 1 m: learning works and a robot can be driven', 0.5),
    Preset('one_second', '1 s, r_a 1 m: the original model, shrunk by three, has 1 s', 1.0),
    Preset(
        'scaled_third', '1 s, r_a 2/3 m: the original 2 m / 3', 1.0, _strombom(sheep_range=2 / 3)
    ),
    Preset('strombom_ra', "1 s, r_a 2 m: Strömbom's own range", 1.0, _strombom(sheep_range=2.0)),
    Preset(
        'rho_a_one',
        '0.5 s, rho_a 1: the base value in section 5',
        0.5,
        _strombom(sheep_repulsion=1.0),
    ),
    Preset('fine_dt', '0.1 s, r_a 1 m: for smooth robots', 0.1),
    Preset(
        'table_literal',
        '1 s, r_a 10 m as printed: the flock expands and never fits the goal',
        1.0,
        _strombom(sheep_range=10.0),
    ),
    Preset(
        'metric_attraction',
        '0.5 s, r_a 10 m with attraction in metres: keeps every number of Table 1',
        0.5,
        _strombom(sheep_range=10.0, metric_attraction=True),
    ),
    # the whole model of Strömbom, shrunk by three: 50 m = 150/3, r_s = 65/3 m, speeds a third
    Preset(
        'third',
        '0.2 s, r_a 2/3 m, unit push: the whole model of Strömbom shrunk by three',
        0.2,
        _strombom(sheep_range=2 / 3, normalize_shepherds=True),
        {
            'strombom': {
                'position_law': 'elfiqi',
                'standoff': 6.0,
                'arc': 'rms',
                'arc_margin': 7.0,
                'stop_distance': 6.0,
            },
            'pierson': {'pace': 'constant', 'weakest_push': 0.4, 'min_radius': 8.0},
        },
    ),
    # the best of a search over what the paper leaves open: docs/results/presets.md
    Preset(
        'paper',
        '0.5 s, r_a 1 m: agrees with most that the paper says of the heuristics',
        0.5,
        {
            'strombom': {'normalize_shepherds': True},
            'reynolds': {'max_acceleration': 1.0},
        },
        {
            'strombom': {
                'interaction_range': 2.0,
                'arc_margin': 10.0,
                'stop_range': 5.0,
                'wing_spacing': 0.2,
            },
            'pierson': {
                'lead': 1.0,
                'gain': 0.2,
                'min_radius': 2.0,
                'spread_factor': 5.0,
                'tracking_gain': 1.0,
            },
        },
    ),
):
    PRESETS.add(preset)


def world_preset(name: str = 'default', flock: str = '', task: str = Herding.name) -> WorldConfig:
    """Return the world of a preset for a task, with its flock model or another; or ConfigError."""
    preset, kind = PRESETS[name], TASKS[task]
    flock = flock or kind.flock
    config = FLOCK_MODELS[flock].config(**preset.flock.get(flock, {}))
    world = WorldConfig(dt=preset.dt, flock=config, task=kind())
    return world.with_values(kind.world) if kind.world else world


def training_world(world: WorldConfig) -> WorldConfig:
    """Return a world that starts as in training: 1 to 6 shepherds, goals of 4 to 8 m."""
    spawn = replace(world.spawn, goal_radius_extra=4.0, fewest_shepherds=1)
    return replace(world, n_shepherds=6, goal_radius=4.0, spawn=spawn)


def home_world(world: WorldConfig) -> WorldConfig:
    """Return a world that starts with the flock in the goal and shepherds all around it."""
    spawn = replace(
        world.spawn,
        flock_distance_min=0.0,
        flock_distance_max=2.0,
        shepherd_distance_min=8.0,
        shepherd_distance_max=30.0,
        shepherds_around=True,
        position_std=3.0,
    )
    return replace(world, spawn=spawn)
