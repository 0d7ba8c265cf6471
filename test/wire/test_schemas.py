"""The contract on the wire: texts of messages, schema of an episode, table of topics."""

from collections import Counter
from copy import deepcopy
import importlib.util
from itertools import product
import json
from pathlib import Path
import sys

from jsonschema import Draft202012Validator
import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.resources import share_file
from shepherd_ros.sim.flocking import FLOCK_MODELS
from shepherd_ros.sim.presets import PRESETS, world_preset
from shepherd_ros.wire.contract import topic_hashes
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.schemas import (
    dependencies,
    installed_text,
    nested_text,
    RULER,
    schema_name,
    schema_text,
    wire_types,
)
from shepherd_ros.wire.topics import contract, families
import yaml

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / 'msg_schemas'
INSTALLED = pytest.mark.skipif(
    importlib.util.find_spec('std_msgs') is None, reason='message packages are not installed'
)


def validator(name):
    schema = json.loads((FOLDER / name).read_text(encoding='utf-8'))
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


def episode(preset='default', flock='strombom'):
    world = world_preset(preset, flock)
    made = Episode(
        number=3,
        seed=17,
        start_ns=12_500_000_000,
        n_sheep=world.n_sheep,
        n_shepherds=world.n_shepherds,
        goal_radius=world.goal_radius,
        frame_id='map',
        mode='lockstep',
        world=world.to_dict(),
    )
    return json.loads(made.to_json())


# ---- texts of messages ----


def test_every_type_of_the_contract_has_a_text():
    for kind in wire_types():
        assert schema_text(kind).strip(), kind
    assert 'geometry_msgs/msg/Twist' in wire_types()  # an alternative type


def test_unknown_type_is_named_with_what_is_known():
    with pytest.raises(ConfigError, match=r"'std_msgs/msg/Floot64'.*did you mean 'std_msgs/msg/F"):
        schema_text('std_msgs/msg/Floot64')


@INSTALLED
def test_a_type_that_is_not_installed_is_named():
    with pytest.raises(FileNotFoundError, match='no_msgs/Nothing is not installed'):
        installed_text('no_msgs/Nothing')


def test_a_type_is_read_from_the_first_prefix_that_has_it_and_a_service_in_three_parts(
    tmp_path, monkeypatch
):
    texts = {'a/msg/Bar': 'int8 a\n', 'b/msg/Bar': 'int8 b\n', 'b/msg/Baz_Event': 'int8 c\n'}
    for name, text in texts.items():
        prefix, kind, message = name.split('/')
        path = tmp_path / prefix / 'share' / 'foo' / kind / f'{message}.msg'
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        (path.parents[1] / 'srv').mkdir(exist_ok=True)
    service = tmp_path / 'b' / 'share' / 'foo' / 'srv' / 'Put.srv'
    service.write_text('int8 x\n---  \nint8 y\n')
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{tmp_path}/none::{tmp_path}/a:{tmp_path}/b')
    assert installed_text('foo/Bar') == 'int8 a\n'
    assert installed_text('foo/Baz_Event') == 'int8 c\n'  # a message may be called so
    assert installed_text('foo/Put_Request') == 'int8 x\n'
    assert installed_text('foo/Put_Response') == '\nint8 y\n'
    expected = (
        'service_msgs/ServiceEventInfo info\nfoo/Put_Request[<=1] request\n'
        'foo/Put_Response[<=1] response\n'
    )
    assert installed_text('foo/Put_Event') == expected
    for missing in ('foo/Put', 'foo/Put_Goal', 'foo/Get_Request', 'bar/Bar'):
        with pytest.raises(FileNotFoundError, match=missing):
            installed_text(missing)


def test_texts_nest_depth_first_and_each_once():
    texts = {
        'a/Top': '# Comment words\na/Left left\nRight[2] right\nint32 N=3\nstring<=10 s\n',
        'a/Left': 'b/Leaf leaf\n',
        'a/Right': 'b/Leaf[] leaves\nfloat64[36] numbers\n',
        'b/Leaf': 'bool there\n',
    }

    def part(name):
        return f'\n{RULER}\nMSG: {name}\n{texts[name]}'

    expected = texts['a/Top'] + part('a/Left') + part('b/Leaf') + part('a/Right')
    assert nested_text('a/msg/Top', texts.__getitem__) == expected
    assert RULER == '=' * 80  # as rosbag2 has it
    assert dependencies(texts['a/Top'], 'a') == ['a/Left', 'a/Right']


@INSTALLED
@pytest.mark.parametrize('kind', wire_types())
def test_text_defines_the_very_type_that_is_installed(kind):
    typesys = pytest.importorskip('rosbags.typesys')
    types = typesys.get_types_from_msg(schema_text(kind), kind)
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.register(types)
    for prefix in (sys.prefix, '/opt/ros/jazzy'):
        described = Path(prefix, 'share', schema_name(kind).replace('/', '/msg/'))
        described = described.with_suffix('.json')
        if described.is_file():
            break
    else:
        pytest.skip('no description of this type is installed')
    hashes = json.loads(described.read_text(encoding='utf-8'))['type_hashes']
    expected = {row['type_name']: row['hash_string'] for row in hashes}
    # the text holds every nested type and no other, each as installed
    assert {name: store.hash_rihs01(name) for name in types} == expected


# ---- episodes ----


def test_episodes_validate():
    for preset, flock in product(sorted(PRESETS), sorted(FLOCK_MODELS)):
        validator('episode.schema.json').validate(episode(preset, flock))


def test_a_flock_model_from_elsewhere_validates_with_model_and_speed():
    data = episode()
    data['world']['flock'] = {'model': 'couzin', 'speed': 0.4, 'blind_angle': 1.2}
    schema = validator('episode.schema.json')
    schema.validate(data)
    for missing in ('model', 'speed'):
        broken = deepcopy(data)
        del broken['world']['flock'][missing]
        assert not schema.is_valid(broken)


def test_broken_episodes_do_not_validate():
    for path, value in [
        ('n_sheep', -1),
        ('n_shepherds', 0),
        ('n_sheep', 2.5),
        ('number', -1),
        ('seed', 'seven'),
        ('seed', 2**63),
        ('goal_radius', 0),
        ('frame_id', ''),
        ('mode', 'fast'),
        ('schema', 2),
        ('version', 'new'),
        ('colour', 'red'),
        ('start.nanosec', 10**9),
        ('start.sec', -1),
        ('start.zone', 'UTC'),
        ('world.dt', 0),
        ('world.n_sheep', 10_001),
        ('world.wind', 1.0),
        ('world.flock.speed', -0.1),
        ('world.flock.metric_attraction', 1),
        ('world.flock.graze_probability', 1.1),
        ('world.flock.graze', 0.1),
        ('world.spawn.position_std', -1.0),
        ('world.spawn.extra', 0),
    ]:
        data = episode()
        *parents, last = path.split('.')
        part = data
        for name in parents:
            part = part[name]
        part[last] = value
        assert not validator('episode.schema.json').is_valid(data)


def keys(data, path=()):
    for name, value in data.items():
        yield (*path, name)
        if isinstance(value, dict):
            yield from keys(value, (*path, name))


def test_no_field_of_an_episode_may_be_missing():
    for path in list(keys(episode())):
        data = episode()
        part = data
        for name in path[:-1]:
            part = part[name]
        del part[path[-1]]
        assert not validator('episode.schema.json').is_valid(data)


@pytest.mark.parametrize('flock', sorted(FLOCK_MODELS))
def test_every_part_of_the_schema_is_described(flock):
    defs = validator('episode.schema.json').schema['$defs']

    def undescribed(schema, where):
        if '$ref' not in schema and not schema.get('description'):
            yield where
        for name, part in schema.get('properties', {}).items():
            yield from undescribed(part, f'{where}.{name}')

    for name in ('world', 'spawn', 'flock', flock):
        assert list(undescribed(defs[name], name)) == []


# ---- topics ----


def test_table_of_topics_validates():
    data = yaml.safe_load((FOLDER / 'topics.yaml').read_text(encoding='utf-8'))
    schema = validator('topics.schema.json')
    schema.validate(data)
    for key, value in (('profile', None), ('type', 'Clock'), ('depth', 3), ('name', 'a//b')):
        broken = deepcopy(data)
        broken['topics'][0][key] = value
        assert not schema.is_valid(broken), key


def test_names_are_unique_and_every_profile_is_used_and_known():
    data = yaml.safe_load((FOLDER / 'topics.yaml').read_text(encoding='utf-8'))
    names = Counter(row['name'] for row in data['topics'])
    assert [name for name, count in names.items() if count > 1] == []
    topics, profiles = contract()
    assert list(topics) == list(names)
    assert {row.profile for row in topics.values()} == set(profiles)


def test_each_topic_and_family_has_a_hash_of_its_own():
    hashes = topic_hashes()
    assert hashes.keys() == contract()[0].keys() | families().keys()
    assert len(set(hashes.values())) == len(hashes)
    assert {len(text) for text in hashes.values()} == {12}


def test_files_are_found_from_the_package():
    assert share_file('msg_schemas', 'topics.schema.json').is_file()
