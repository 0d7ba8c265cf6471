"""Configurations: what is refused and how it is said, and the way to plain data and back."""

from __future__ import annotations

from dataclasses import fields, FrozenInstanceError
from itertools import product
import json
import math
from typing import Any

import pytest
from shepherd_ros.config import checked, Config, ConfigError, unknown_name
from shepherd_ros.controllers import CONTROLLERS, make_controller
from shepherd_ros.controllers.pierson import PiersonConfig
from shepherd_ros.controllers.strombom import StrombomConfig
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.flocking import FLOCK_MODELS
from shepherd_ros.sim.flocking.reynolds_flock import ReynoldsFlock
from shepherd_ros.sim.flocking.strombom_flock import StrombomFlock
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.limits import MAX_SHEEP, MAX_SHEPHERDS
from shepherd_ros.sim.observation import ObservationConfig
from shepherd_ros.sim.presets import home_world, PRESETS, training_world, world_preset
from shepherd_ros.sim.reward import RewardConfig
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import SpawnConfig, WorldConfig

CLASSES: list[type[Config]] = [
    EnvConfig,
    WorldConfig,
    SpawnConfig,
    LidarConfig,
    ObservationConfig,
    RewardConfig,
    *(model.config for model in FLOCK_MODELS.values()),
    *(controller.config_type for controller in CONTROLLERS.values()),
]
OPTIONS = [(c, f) for c in CLASSES for f in fields(c) if 'doc' in f.metadata]
FREE_TEXT = {'checkpoint', 'drive', 'hold'}  # options that any text may be given to


def message(config: Any, **values: Any) -> str:
    with pytest.raises(ConfigError) as error:
        config(**values)
    return str(error.value)


# --- each option of each configuration ----------------------------------------------------------


def test_an_option_has_a_sentence_and_a_default_that_is_allowed() -> None:
    for config, field in OPTIONS:
        assert len(field.metadata['doc']) > 5, f'{config.__name__}.{field.name}'
        assert getattr(config(**{field.name: field.default}), field.name) == field.default


@pytest.mark.parametrize('bad', [None, [1.0], 'many', b'x', 1 + 2j, object], ids=repr)
def test_an_option_of_another_type_is_refused(bad: Any) -> None:
    for config, field in OPTIONS:
        if field.name not in FREE_TEXT or not isinstance(bad, str):
            output = message(config, **{field.name: bad})
            assert output.startswith(f'{field.name} is {bad!r}')
            assert 'expected' in output


def test_an_option_of_free_text_takes_any() -> None:
    free = [(config, field) for config, field in OPTIONS if field.name in FREE_TEXT]
    assert {field.name for _, field in free} == FREE_TEXT
    for config, field in free:
        assert getattr(config(**{field.name: 'many'}), field.name) == 'many'


def test_numbers_and_switches_are_not_mistaken_for_each_other() -> None:
    others = {bool: (0, 1, 1.0), int: (True, 2.0), float: (True, False), str: (1, True)}
    for config, field in OPTIONS:
        kind = type(field.default)
        for bad in others[kind]:
            output = message(config, **{field.name: bad})
            assert f'{field.name} is {bad!r} ({type(bad).__name__})' in output
            assert f'expected {kind.__name__}, such as {field.default!r}' in output


def test_a_number_that_is_not_finite_is_refused() -> None:
    for config, field in OPTIONS:
        for bad in (math.nan, math.inf, -math.inf):
            output = message(config, **{field.name: bad})
            assert output.startswith(f'{field.name} is {bad}')
            if isinstance(field.default, float):
                assert f'expected a finite number, such as {field.default}' in output


@pytest.mark.parametrize(('end', 'outside'), [('low', -1), ('high', 1)])
def test_a_number_outside_its_range_is_refused_and_the_ends_are_allowed(
    end: str, outside: int
) -> None:
    limited = [(c, f) for c, f in OPTIONS if f.metadata[end] is not None]
    assert len(limited) > 10
    for config, field in limited:
        limit = type(field.default)(field.metadata[end])
        bad = limit + outside
        output = message(config, **{field.name: bad})
        assert output.startswith(f'{field.name} is {bad}: expected a value in [')
        assert f', such as {field.default}' in output
        assert str(field.metadata[end]) in output
        assert checked(field.name, limit, field.default, field.metadata) == limit


def test_a_choice_that_is_none_is_refused_with_those_there_are() -> None:
    chosen = [(c, f) for c, f in OPTIONS if f.metadata['choices']]
    assert len(chosen) > 3
    for config, field in chosen:
        output = message(config, **{field.name: field.default + 'x'})
        assert f'{field.name} is {field.default + "x"!r}' in output
        assert f'did you mean {field.default!r}?' in output
        for choice in field.metadata['choices']:
            assert choice in output
        assert 'did you mean' not in message(config, **{field.name: '???'})


# --- messages in full ---------------------------------------------------------------------------


def test_messages_name_the_value_and_what_was_expected() -> None:
    assert message(WorldConfig, n_sheep=0) == (
        'n_sheep is 0: expected a value in [1, 10000], such as 100'
    )
    assert message(WorldConfig, n_sheep='12') == (
        "n_sheep is '12' (str): expected int, such as 100"
    )
    assert message(WorldConfig, shepherd_speed=-1.0) == (
        'shepherd_speed is -1.0: expected a value in [0.0, inf], such as 1.0'
    )
    assert message(WorldConfig, dt=math.nan) == (
        'dt is nan: expected a finite number, such as 0.5'
    )
    assert message(ObservationConfig, layout='rings') == (
        "layout is 'rings': expected one of types, frames, ring; did you mean 'ring'?"
    )
    assert str(unknown_name('flock', 'cows', ['sheep', 'goats'])) == (
        "flock is 'cows': expected one of sheep, goats"
    )


def test_an_int_is_taken_where_a_float_is_expected_and_becomes_one() -> None:
    config = WorldConfig(dt=1)
    assert config.dt == 1.0
    assert type(config.dt) is float


def test_an_int_too_great_for_a_float_is_refused_like_any_other_value() -> None:
    assert message(WorldConfig, goal_radius=10**400) == (
        'goal_radius is inf: expected a finite number, such as 4.0'
    )


def test_intervals_of_the_spawn_have_to_be_in_order() -> None:
    assert message(SpawnConfig, flock_distance_min=30.0) == (
        'flock_distance_min is 30.0: expected at most flock_distance_max, 20.0'
    )
    assert message(SpawnConfig, shepherd_distance_max=2.0) == (
        'shepherd_distance_min is 5.0: expected at most shepherd_distance_max, 2.0'
    )
    assert SpawnConfig(flock_distance_min=15.0, flock_distance_max=15.0)


def test_the_smallest_team_has_to_fit_in_the_team() -> None:
    output = message(WorldConfig, n_shepherds=2, spawn=SpawnConfig(fewest_shepherds=3))
    assert output == 'fewest_shepherds is 3: expected at most n_shepherds, 2'
    assert WorldConfig(n_shepherds=3, spawn=SpawnConfig(fewest_shepherds=3))


def test_the_greatest_sizes_are_allowed_and_one_more_is_not() -> None:
    assert WorldConfig(n_sheep=MAX_SHEEP, n_shepherds=MAX_SHEPHERDS)
    assert 'n_sheep' in message(WorldConfig, n_sheep=MAX_SHEEP + 1)
    assert 'n_shepherds' in message(WorldConfig, n_shepherds=MAX_SHEPHERDS + 1)


def test_a_part_of_the_wrong_kind_is_refused() -> None:
    assert 'spawn' in message(WorldConfig, spawn={'position_std': 1.0})
    assert 'flock' in message(WorldConfig, flock='strombom')
    assert 'world' in message(EnvConfig, world=3)
    assert 'lidar' in message(EnvConfig, lidar=RewardConfig())


def test_a_configuration_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        WorldConfig().n_sheep = 3  # type: ignore[misc]


# --- plain data ---------------------------------------------------------------------------------


def test_a_default_configuration_survives_json() -> None:
    for config in CLASSES:
        data = json.loads(json.dumps(config().to_dict()))
        assert config.from_dict(data) == config()


@pytest.mark.parametrize(
    'flock', [StrombomFlock(n_neighbors=7, metric_attraction=True), ReynoldsFlock(fear=3.0)]
)
def test_a_world_with_its_flock_survives_json_inside_an_environment(flock: Any) -> None:
    world = WorldConfig(
        n_sheep=7, dt=0.1, spawn=SpawnConfig(position_std=2.0, fewest_shepherds=1), flock=flock
    )
    env = EnvConfig(
        noise_std=0.3,
        world=world,
        lidar=LidarConfig(n_rays=64, cross_occlusion=True),
        observation=ObservationConfig(layout='ring'),
        reward=RewardConfig(one_per_step=True),
    )
    data = json.loads(json.dumps(env.to_dict()))
    assert data['world']['flock']['model'] in FLOCK_MODELS
    assert EnvConfig.from_dict(data) == env
    assert WorldConfig.from_dict(data['world']) == world
    assert type(WorldConfig.from_dict(data['world']).flock) is type(flock)


def test_what_data_leave_out_keeps_its_default() -> None:
    assert EnvConfig.from_dict({}) == EnvConfig()
    assert WorldConfig.from_dict({'n_sheep': 5}) == WorldConfig(n_sheep=5)
    result = EnvConfig.from_dict(
        {'world': {'flock': {'model': 'reynolds'}}, 'lidar': {'n_rays': 16}}
    )
    assert result == EnvConfig(
        world=WorldConfig(flock=ReynoldsFlock()), lidar=LidarConfig(n_rays=16)
    )


def test_an_unknown_name_in_data_is_refused() -> None:
    for config in CLASSES:
        with pytest.raises(ConfigError, match='nonsense'):
            config.from_dict({'nonsense': 1})


@pytest.mark.parametrize(
    ('config', 'data', 'near'),
    [
        (LidarConfig, {'n_ray': 1}, 'n_rays'),
        (RewardConfig, {'occupency': 1.0}, 'occupancy'),
        (EnvConfig, {'lider': {}}, 'lidar'),
        (EnvConfig, {'lidar': {'range': 1.0}}, 'range_max'),
        (WorldConfig, {'n_sheeps': 5}, 'n_sheep'),
        (WorldConfig, {'spawn': {'position_sd': 1.0}}, 'position_std'),
        (WorldConfig, {'flock': {'model': 'reynold'}}, 'reynolds'),
        (WorldConfig, {'flock': {'model': 'reynolds', 'feer': 1.0}}, 'fear'),
    ],
    ids=str,
)
def test_a_misspelt_name_in_data_is_refused_with_the_nearest(
    config: type[Config], data: dict[str, Any], near: str
) -> None:
    with pytest.raises(ConfigError, match=rf"did you mean '{near}'\?"):
        config.from_dict(data)


@pytest.mark.parametrize(
    'data',
    [
        {'flock': 'strombom'},
        {'flock': 3},
        {'flock': None},
        {'flock': {'model': 7}},
        {'spawn': 3},
        {'spawn': 'near'},
        {'n_sheep': '5'},
        {'flock': {'model': 'strombom', 'noise': 'much'}},
    ],
    ids=str,
)
def test_data_of_the_wrong_kind_are_refused(data: dict[str, Any]) -> None:
    with pytest.raises(ConfigError):
        WorldConfig.from_dict(data)
    with pytest.raises(ConfigError):
        EnvConfig.from_dict({'world': data})


def test_values_in_data_are_checked_as_in_code() -> None:
    with pytest.raises(ConfigError, match='n_rays is 2: expected a value in'):
        EnvConfig.from_dict({'lidar': {'n_rays': 2}})


# --- presets, controllers, environment ----------------------------------------------------------


def test_a_preset_is_a_world_with_its_time_step_and_flock() -> None:
    for name, flock in product(PRESETS, FLOCK_MODELS):
        world = world_preset(name, flock)
        assert world.dt == PRESETS[name].dt
        assert type(world.flock) is FLOCK_MODELS[flock].config
        for option, value in PRESETS[name].flock.get(flock, {}).items():
            assert getattr(world.flock, option) == value


def test_the_presets_of_the_design_are_there() -> None:
    expected = {
        'default': (0.5, 1.0),
        'one_second': (1.0, 1.0),
        'scaled_third': (1.0, 2 / 3),
        'strombom_ra': (1.0, 2.0),
        'fine_dt': (0.1, 1.0),
        'table_literal': (1.0, 10.0),
    }
    for name, (dt, sheep_range) in expected.items():
        world = world_preset(name)
        assert (world.dt, world.flock.sheep_range) == (dt, sheep_range)
    assert world_preset('rho_a_one').flock.sheep_repulsion == 1.0
    assert world_preset('metric_attraction').flock.metric_attraction
    assert world_preset('metric_attraction').flock.sheep_range == 10.0
    assert [world_preset(name).dt for name in ('rho_a_one', 'metric_attraction')] == [0.5, 0.5]


def test_the_presets_with_heuristics_of_their_own_have_their_numbers() -> None:
    paper, third = PRESETS['paper'], PRESETS['third']
    assert (paper.dt, third.dt) == (0.5, 0.2)
    assert paper.flock == {
        'strombom': {'normalize_shepherds': True}, 'reynolds': {'max_acceleration': 1.0},
    }  # fmt: skip
    assert paper.controllers == {
        'strombom': {'interaction_range': 2.0, 'arc_margin': 10.0, 'stop_range': 5.0,
                     'wing_spacing': 0.2},
        'pierson': {'lead': 1.0, 'gain': 0.2, 'min_radius': 2.0, 'spread_factor': 5.0,
                    'tracking_gain': 1.0},
    }  # fmt: skip
    # all lengths of Strömbom's model are three times as long
    assert third.flock == {'strombom': {'sheep_range': 2 / 3, 'normalize_shepherds': True}}
    assert third.controllers == {
        'strombom': {'position_law': 'elfiqi', 'standoff': 6.0, 'arc': 'rms', 'arc_margin': 7.0,
                     'stop_distance': 6.0},
        'pierson': {'pace': 'constant', 'weakest_push': 0.4, 'min_radius': 8.0},
    }  # fmt: skip


def test_a_start_at_home_is_that_of_the_design() -> None:
    start = home_world(WorldConfig()).spawn
    assert (start.flock_distance_min, start.flock_distance_max) == (0.0, 2.0)
    assert (start.shepherd_distance_min, start.shepherd_distance_max) == (8.0, 30.0)
    assert (start.shepherds_around, start.position_std) == (True, 3.0)


def test_the_default_world_is_that_of_the_paper() -> None:
    flock = world_preset().flock
    assert (flock.sheep_repulsion, flock.cohesion, flock.shepherd_repulsion) == (2.0, 1.05, 1.0)
    assert (flock.inertia, flock.noise, flock.graze_probability) == (0.5, 0.3, 0.05)
    assert (flock.n_neighbors, flock.shepherd_range, flock.speed) == (90, 65 / 3, 1 / 3)
    assert (RewardConfig().occupancy, RewardConfig().shaping) == (10.0, -0.1)
    boids = ReynoldsFlock()
    assert (boids.view_range, boids.separation, boids.alignment) == (7.5, 1.0, 7.5)
    assert (boids.cohesion, boids.fear, boids.speed) == (1.0, 10.0, 1 / 3)
    assert (LidarConfig().n_rays, LidarConfig().range_max) == (512, 75.0)


def test_training_worlds_differ_in_goal_and_team() -> None:
    world = world_preset('fine_dt', 'reynolds')
    training = training_world(world)
    assert (training.n_sheep, training.n_shepherds, training.spawn.fewest_shepherds) == (100, 6, 1)
    assert (training.goal_radius, training.spawn.goal_radius_extra) == (4.0, 4.0)
    assert (world.goal_radius, world.spawn.goal_radius_extra) == (4.0, 0.0)
    assert world.spawn.fewest_shepherds == 0
    assert training.dt == world.dt == 0.1
    assert training.flock == world.flock


def test_unknown_presets_flocks_and_controllers_are_refused_with_the_nearest_name() -> None:
    for make, bad, near in (
        (world_preset, 'fine_td', 'fine_dt'),
        (lambda name: world_preset('default', name), 'stromboom', 'strombom'),
        (CONTROLLERS.__getitem__, 'peirson', 'pierson'),
        (lambda name: make_controller(name, WorldConfig()), 'idel', 'idle'),
    ):
        with pytest.raises(ConfigError, match=rf"'{bad}'.*did you mean '{near}'\?"):
            make(bad)


def test_options_of_a_controller_are_checked() -> None:
    with pytest.raises(ConfigError, match=r'noise is -1.0: expected a value in \[0.0, inf\]'):
        make_controller('strombom', WorldConfig(), noise=-1.0)
    assert make_controller('pierson', WorldConfig(), lead=3).config == PiersonConfig(lead=3.0)
    assert make_controller('strombom', WorldConfig()).config == StrombomConfig()


def test_an_environment_has_at_least_one_world() -> None:
    with pytest.raises(ValueError, match='n_worlds is 0: expected at least 1'):
        ShepherdEnv(EnvConfig(), 0)
