"""The layouts of RViz, Foxglove and PlotJuggler show topics of the contract, of fitting types."""

import json
from pathlib import Path
import re
from xml.etree import ElementTree

import pytest
from shepherd_ros.ros.node import message_type
from shepherd_ros.wire.topics import contract
import yaml

CONFIG = Path(__file__).resolve().parents[1] / 'config'
TOPICS, PROFILES = contract()
SHOWS = {  # display or tool of RViz -> type of its topic
    'MarkerArray': 'visualization_msgs/msg/MarkerArray',
    'LaserScan': 'sensor_msgs/msg/LaserScan',
    'PoseArray': 'geometry_msgs/msg/PoseArray',
    'Pose': 'geometry_msgs/msg/PoseStamped',
    'SetGoal': 'geometry_msgs/msg/PoseStamped',
}
DRAWN = set(SHOWS.values())  # what the 3D panel of Foxglove can draw


ROWS = {  # topic in the root namespace -> its row of the contract
    candidate if candidate.startswith('/') else f'/{candidate}': topic
    for original, topic in TOPICS.items()
    for candidate in [re.sub(r'\{h\}', '0', original)]
}


def row(name):
    """Return the topic of the contract that a viewer means in the root namespace."""
    assert name in ROWS, f'{name} is no topic of the contract'
    return ROWS[name]


@pytest.fixture(scope='module')
def rviz():
    return yaml.safe_load((CONFIG / 'shepherd.rviz').read_text(encoding='utf-8'))


@pytest.fixture(scope='module')
def foxglove():
    return json.loads((CONFIG / 'foxglove_layout.json').read_text(encoding='utf-8'))


def parts(rviz):
    """Return (class, topic) of every display and tool that has a topic."""
    manager = rviz['Visualization Manager']
    rows = [*manager['Displays'], *manager['Tools']]
    return [(row['Class'].split('/')[1], row['Topic']) for row in rows if 'Topic' in row]


def test_rviz_shows_topics_of_the_contract(rviz):
    for kind, topic in parts(rviz):
        assert row(topic['Value']).type == SHOWS[kind], topic['Value']


def test_rviz_asks_for_no_more_than_is_offered(rviz):
    for kind, topic in parts(rviz):
        offered = PROFILES[row(topic['Value']).profile]
        if kind == 'SetGoal':  # a publisher: the node's subscriber asks
            assert topic['Reliability Policy'] == 'Reliable'
            continue
        if topic['Reliability Policy'] == 'Reliable':
            assert offered.reliability == 'reliable', topic['Value']
        latched = offered.durability == 'transient_local'
        assert topic['Durability Policy'] == ('Transient Local' if latched else 'Volatile')
        assert topic['History Policy'] == 'Keep Last'


def test_rviz_has_what_herding_needs(rviz):
    shown = {(kind, topic['Value']) for kind, topic in parts(rviz)}
    scans = {('LaserScan', f'/shepherd_0/scan/{c}') for c in ('sheep', 'shepherds', 'goal')}
    assert shown == scans | {
        ('MarkerArray', '/markers'),
        ('PoseArray', '/flock/poses'),
        ('PoseArray', '/shepherds/poses'),
        ('Pose', '/goal'),
        ('SetGoal', '/goal_pose'),
    }
    manager = rviz['Visualization Manager']
    assert manager['Global Options']['Fixed Frame'] == 'map'
    classes = [part['Class'] for part in manager['Displays'] + manager['Tools']]
    assert all(kind.startswith('rviz_default_plugins/') for kind in classes)
    assert all('Name' in display for display in manager['Displays'])


def test_rviz_looks_down_on_60_m_around_the_goal(rviz):
    view = rviz['Visualization Manager']['Views']['Current']
    assert view['Class'] == 'rviz_default_plugins/TopDownOrtho'
    assert (view['X'], view['Y']) == (0, 0)  # every episode starts with the goal there
    metres = rviz['Window Geometry']['Height'] / view['Scale']  # scale: pixels per metre
    assert 60 <= metres <= 70  # menus and the time panel take some of the window


def names(layout):
    """Return the panels that a layout places."""
    return (
        [layout] if isinstance(layout, str) else names(layout['first']) + names(layout['second'])
    )


def test_foxglove_places_every_panel_once(foxglove):
    placed = names(foxglove['layout'])
    assert sorted(placed) == sorted(foxglove['configById'])
    kinds = [name.split('!')[0] for name in placed]
    assert sorted(kinds) == ['3D', 'DiagnosticSummary', 'Plot', 'Plot']


def test_foxglove_draws_topics_of_the_contract(foxglove):
    panel = foxglove['configById']['3D!world']
    for topic in panel['topics']:
        assert row(topic).type in DRAWN, topic
    assert panel['topics']['/markers']['visible']
    assert panel['followTf'] == 'map'
    assert (
        panel['cameraState'] | {'perspective': False, 'phi': 0, 'distance': 60}
        == (panel['cameraState'])
    )


def test_foxglove_sends_goals(foxglove):
    publish = foxglove['configById']['3D!world']['publish']
    assert publish == {'type': 'pose', 'poseTopic': '/goal_pose'}
    assert row(publish['poseTopic']).type == 'geometry_msgs/msg/PoseStamped'


def test_foxglove_plots_numbers_of_the_contract(foxglove):
    paths = [
        path['value']
        for name, panel in foxglove['configById'].items()
        if name.startswith('Plot!')
        for path in panel['paths']
    ]
    for path in paths:
        topic, field = path.rsplit('.', 1)
        assert (row(topic).type, field) == ('std_msgs/msg/Float64', 'data'), path
    assert {'/metrics/fraction_in_goal.data', '/metrics/goal_distance.data'} <= set(paths)


def test_foxglove_shows_diagnostics(foxglove):
    topic = foxglove['configById']['DiagnosticSummary!nodes']['topicToRender']
    assert row(topic).type == 'diagnostic_msgs/msg/DiagnosticArray'


def test_plotjuggler_plots_numbers_of_the_contract():
    root = ElementTree.parse(CONFIG / 'plotjuggler.xml').getroot()
    curves = [curve.get('name') for curve in root.iter('curve')]
    for curve in curves:
        topic = max((t for t in ROWS if curve.startswith(f'{t}/')), key=len)
        value = message_type(row(topic).type)()
        for field in curve.removeprefix(f'{topic}/').split('/'):
            value = getattr(value, field)
        assert isinstance(value, float), curve
    assert {'/metrics/fraction_in_goal/data', '/metrics/goal_distance/data'} <= set(curves)
    for splitter in root.iter('DockSplitter'):
        assert int(splitter.get('count')) == len(splitter) == len(splitter.get('sizes').split(';'))
