"""The description of an episode: it comes back from JSON, and a bad one is refused in words."""

from __future__ import annotations

from itertools import product
import json
import math
from typing import Any

import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.sim.flocking import FLOCK_MODELS
from shepherd_ros.sim.presets import PRESETS, training_world, world_preset
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.wire.episode import Episode

SENSELESS: list[dict[str, Any]] = [
    {'number': None}, {'seed': 'x'}, {'n_sheep': 0}, {'n_sheep': 10**6}, {'n_shepherds': -1},
    {'start': {}}, {'start': {'sec': -1, 'nanosec': 0}}, {'world': {}}, {'world': 3},
    {'world': {'dt': 0.0, 'episode_steps': 4}}, {'world': {'dt': 1e400, 'episode_steps': 4}},
    {'world': {'dt': 0.5, 'episode_steps': 10**9}}, {'seed': 2**63}, {'seed': 2**70},
    {'n_sheep': -1}, {'n_sheep': 10**4000}, {'start': {'sec': 'a' * 4000, 'nanosec': 0}},
    {'goal_radius': math.nan}, {'goal_radius': 0.0}, {'goal_radius': 10**400}, {'mode': 'turbo'},
    {'start': {'sec': 1.5, 'nanosec': 0}}, {'start': {'sec': 1, 'nanosec': 0.0}},
    {'frame_id': ''}, {'version': 'new'}, {'version': ''}, {'schema': True}, {'schema': 0},
]  # fmt: skip


def episode_of(preset: str = 'default', model: str = 'strombom', **changes: Any) -> Episode:
    """Return an episode with a world of a preset."""
    world = world_preset(preset, model)
    values: dict[str, Any] = {
        'number': 2, 'seed': 41, 'start_ns': 7_500_000_000, 'n_sheep': 100, 'n_shepherds': 3,
        'goal_radius': 4.123456789, 'frame_id': 'map', 'mode': 'lockstep',
        'world': world.to_dict(),
    }  # fmt: skip
    return Episode(**(values | changes))


def test_an_episode_comes_back_from_json_as_it_was() -> None:
    for model, preset in product(sorted(FLOCK_MODELS), sorted(PRESETS)):
        episode = episode_of(preset, model)
        assert Episode.from_json(episode.to_json()) == episode
        world = WorldConfig.from_dict(episode.world)
        assert world == world_preset(preset, model)
        other = episode_of(world=training_world(world).to_dict(), seed=-3, start_ns=0)
        assert Episode.from_json(other.to_json()) == other


def test_an_episode_begins_at_seconds_and_nanoseconds_and_has_one_step_at_least() -> None:
    one_step = {**world_preset().to_dict(), 'episode_steps': 1}
    episode = episode_of(world=one_step)
    assert json.loads(episode.to_json())['start'] == {'sec': 7, 'nanosec': 500_000_000}
    assert Episode.from_json(episode.to_json()) == episode


def test_steps_of_an_episode_are_counted_from_its_first_stamp() -> None:
    episode = episode_of()  # 1000 steps of 0.5 s from 7.5 s on
    assert episode.dt_ns == 500_000_000
    assert episode_of('one_second').dt_ns == 1_000_000_000
    assert episode.step_of(7_500_000_000) == 0
    assert episode.step_of(8_000_000_000) == 1
    assert episode.has(7_500_000_000)
    assert episode.has(507_500_000_000)
    assert not episode.has(7_000_000_000)
    assert not episode.has(508_000_000_000)


def changed(**changes: Any) -> str:
    """Return an episode as JSON with other values at its top, or in its world."""
    data = json.loads(episode_of().to_json())
    if isinstance(changes.get('world'), dict):
        changes['world'] = data['world'] | changes['world']
    return json.dumps(data | changes)


@pytest.mark.parametrize(
    ('text', 'pattern'),
    [
        ('', 'cannot be read'),
        ('no JSON', "'no JSON' cannot be read"),
        ('null', 'cannot be read'),
        ('[]', 'cannot be read'),
        ('3', 'cannot be read'),
        ('{}', "KeyError.*'schema'"),
        ('{"schema": 1}', "KeyError.*'number'"),
        (changed(schema=99), 'schema is 99: expected 1'),
        (changed(start=None), 'cannot be read'),
        (changed(start={'sec': '1', 'nanosec': 0}), 'cannot be read'),
        (changed(seed='seven'), 'seven'),
        (changed(n_sheep=math.inf), 'cannot be read'),
        (changed(goal_radius='wide'), 'wide'),
        (changed(world=[]), 'cannot be read|expected a mapping'),
        (changed(world={'flock': 'strombom'}), 'cannot be read|expected a mapping'),
        (changed(world={'flock': {'model': 'boids'}}), "flock is 'boids': expected one of"),
        (changed(world={'dt': 'half'}), "dt is 'half'.*expected float"),
        (changed(world={'dt': math.nan}), 'dt is nan: expected a finite number'),
        (changed(world={'weather': 'fine'}), 'weather'),
        (changed(world={'spawn': {'place': 1}}), "'place'"),
    ],
    ids=lambda value: value[:12],
)
def test_a_bad_episode_is_refused_in_words(text: str, pattern: str) -> None:
    with pytest.raises(ConfigError, match=pattern):
        WorldConfig.from_dict(Episode.from_json(text).world)


def test_an_episode_that_makes_no_sense_is_refused() -> None:
    for change in SENSELESS:
        text = json.dumps({**json.loads(episode_of().to_json()), **change})
        with pytest.raises(ConfigError, match='cannot be read'):
            Episode.from_json(text)


def test_numbers_at_their_limits_are_taken_and_those_beyond_refused() -> None:
    limits = {
        ('number',): (0, 2**63 - 1), ('seed',): (-(2**63), 2**63 - 1), ('n_sheep',): (1, 10_000),
        ('n_shepherds',): (1, 100), ('start', 'sec'): (0, 2**31 - 1),
        ('start', 'nanosec'): (0, 10**9 - 1), ('world', 'episode_steps'): (1, 10**7),
    }  # fmt: skip
    for (*parents, name), (low, high) in limits.items():
        for value in (low - 1, low, high, high + 1):
            data = json.loads(episode_of().to_json())
            part = data[parents[0]] if parents else data
            part[name] = value
            if low <= value <= high:
                assert json.loads(Episode.from_json(json.dumps(data)).to_json()) == data
            else:
                with pytest.raises(ConfigError, match=f'{name} is {value}'):
                    Episode.from_json(json.dumps(data))


def test_a_text_that_is_no_episode_is_refused() -> None:
    for text in ['', '{', 'null', '[]', '"x"', '[' * 100_000, '{"number": 1}', '9' * 5_000]:
        with pytest.raises(ConfigError, match='cannot be read'):
            Episode.from_json(text)
