"""The running stack against msg_schemas/topics.yaml, both ways, and its parameters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nodes.process import BEST_EFFORT, Graph, LATCHED, nanoseconds, Process, RELIABLE
import pytest
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from shepherd_ros.controllers.strombom import StrombomConfig
from shepherd_ros.ros.node import message_type, quality
from shepherd_ros.sim.flocking import FLOCK_MODELS
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.presets import world_preset
from shepherd_ros.sim.tasks import TASKS
from shepherd_ros.sim.world import SpawnConfig, WorldConfig
from shepherd_ros.wire.topics import CLOCK, COMMANDS, contract

CONTRACT, PROFILES = contract()
pytestmark = pytest.mark.xdist_group('contract')  # one stack for all
TASK = world_preset().task  # the metrics of other tasks are published in their episodes
TOPICS = {
    topic: row
    for topic, row in CONTRACT.items()
    if not row.name.startswith('metrics/') or row.name.removeprefix('metrics/') in TASK.metrics
}
OF_ROS = {'/rosout', '/parameter_events', '/tf'}  # /tf where tf2_msgs is installed
OF_RCLPY = {'use_sim_time', 'start_type_description_service'}
N_SHEPHERDS = 3
NODES = {  # node -> executable, parameters, shepherds that it serves
    'flock_sim': (
        'flock_sim',
        {'n_sheep': 20, 'wait_for_scans': True, 'rate': 20.0, 'goal_speed': 0.01},
        [0, 1, 2],
    ),
    'lidar': ('lidar', {}, [0]),
    'lidar_b': ('lidar', {'shepherd_ids': [1, 2]}, [1, 2]),
    'strombom': ('strombom', {}, [0, 1, 2]),
    'metrics': ('metrics', {}, []),
    'policy': ('policy', {'shepherd_ids': [1]}, [1]),
}
ROLES = {'strombom': 'controller'}
Stack = dict[str, Process]


@pytest.fixture(scope='module')
def stack(shared_graph: Graph) -> Iterator[Stack]:
    """Run the whole stack as processes, until it moves."""
    track = shared_graph.track()
    processes = {
        name: shared_graph.start(executable, '-r', f'__node:={name}', **parameters)
        for name, (executable, parameters, _) in NODES.items()
    }
    shared_graph.until(lambda: len(track.stamps) > 5, 'the world moves')
    shared_graph.until_nodes(*NODES)
    shared_graph.forget(track)
    yield processes
    for process in processes.values():
        assert process.code is None, process
        process.kill()


def name_of(topic: str, shepherd: int) -> str:
    """Return the full name of a topic of the contract in the graph."""
    name = topic.format(h=shepherd)
    return name if name.startswith('/') else f'/{name}'


def named(role: str) -> set[tuple[str, str, str]]:
    """Return topic, type and node of each end that the contract names, for the nodes that run."""
    ends = set()
    for row in TOPICS.values():
        for node, (executable, _, shepherds) in NODES.items():
            names = {executable, ROLES.get(executable, executable)}
            if names & set(getattr(row, role)):
                for h in shepherds if '{h}' in row.name else [0]:
                    ends.add((name_of(row.name, h), row.type, node))
    return ends


def found(graph: Graph, role: str) -> dict[tuple[str, str, str], Any]:
    """Return the same as the graph has it, with the profile of each end."""
    ends = {}
    for topic, _ in graph.node.get_topic_names_and_types():
        look = {
            'publisher': graph.node.get_publishers_info_by_topic,
            'subscribers': graph.node.get_subscriptions_info_by_topic,
        }[role]
        for info in look(topic):
            if info.node_name in NODES and topic not in OF_ROS:
                ends[topic, info.topic_type, info.node_name] = info.qos_profile
    return ends


# --- topics -------------------------------------------------------------------------------------


def test_what_is_published_is_what_the_contract_names_and_nothing_else(
    shared_graph: Graph, stack: Stack
) -> None:
    expected = named('publisher')
    shared_graph.until(
        lambda: found(shared_graph, 'publisher').keys() >= expected,
        lambda: f'publishers {expected - found(shared_graph, "publisher").keys()}',
    )
    assert found(shared_graph, 'publisher').keys() - expected == set()


def test_what_is_subscribed_to_is_what_the_contract_names_and_nothing_else(
    shared_graph: Graph, stack: Stack
) -> None:
    expected = named('subscribers')
    shared_graph.until(
        lambda: found(shared_graph, 'subscribers').keys() >= expected,
        lambda: f'subscribers {expected - found(shared_graph, "subscribers").keys()}',
    )
    own = {'/clock'}  # only with use_sim_time, which every node has from rclpy
    assert {end for end in found(shared_graph, 'subscribers') if end[0] not in own} == expected


def row_of(topic: str) -> str:
    """Return the name in the contract of a topic in the graph."""
    return next(name for name in TOPICS for h in range(N_SHEPHERDS) if name_of(name, h) == topic)


def test_publishers_offer_the_quality_of_service_of_the_contract(
    shared_graph: Graph, stack: Stack
) -> None:
    for (topic, _, node), qos in found(shared_graph, 'publisher').items():
        profile = PROFILES[TOPICS[row_of(topic)].profile]
        assert qos.reliability == ReliabilityPolicy[profile.reliability.upper()], (topic, node)
        assert qos.durability == DurabilityPolicy[profile.durability.upper()], (topic, node)
        if qos.depth:  # Fast DDS does not transmit it
            assert qos.depth == profile.depth, (topic, node)


def test_subscribers_ask_for_what_the_contract_says_and_publishers_offer(
    shared_graph: Graph, stack: Stack
) -> None:
    for (topic, _, node), qos in found(shared_graph, 'subscribers').items():
        profile = PROFILES[TOPICS[row_of(topic)].profile]
        wanted = profile.subscribe or profile.reliability
        assert qos.reliability == ReliabilityPolicy[wanted.upper()], (topic, node)
        assert qos.durability == DurabilityPolicy[profile.durability.upper()], (topic, node)
        for (other, _, _), offered in found(shared_graph, 'publisher').items():
            if other == topic:
                assert offered.reliability in (qos.reliability, ReliabilityPolicy.RELIABLE)
                assert offered.durability in (qos.durability, DurabilityPolicy.TRANSIENT_LOCAL)


def test_the_depth_of_a_publisher_and_of_a_subscriber_is_that_of_the_contract() -> None:
    for topic in sorted(TOPICS):
        profile = PROFILES[TOPICS[topic].profile]
        assert quality(topic).depth == quality(topic, subscribe=True).depth == profile.depth
    for topic in (CLOCK, COMMANDS):  # what a recorder that is held up must not miss
        assert quality(topic).depth >= 10


HEADERS = [  # what a user or mux publishes is not there
    row for row in TOPICS.values() if row.publisher not in (('user',), ('mux',))
]


@pytest.mark.parametrize('row', HEADERS, ids=lambda row: row.name)
def test_messages_come_in_the_frame_of_the_contract_and_with_a_stamp(
    shared_graph: Graph, stack: Stack, row: Any
) -> None:
    frames = {'world': 'map', 'shepherd': 'shepherd_1'}
    profile = PROFILES[row.profile]
    qos = BEST_EFFORT if profile.subscribe == 'best_effort' else RELIABLE
    qos = LATCHED if profile.durability == 'transient_local' else qos
    kind = message_type(row.type)
    received: list[Any] = []
    subscription = shared_graph.node.create_subscription(
        kind, name_of(row.name, 1), received.append, qos
    )
    shared_graph.until(lambda: received, f'a message of {row.name}')
    shared_graph.node.destroy_subscription(subscription)
    message = received[-1]
    if row.frame == 'none':
        assert getattr(getattr(message, 'header', None), 'frame_id', '') == ''
        return
    headers = [message.header] if hasattr(message, 'header') else []
    headers += [marker.header for marker in getattr(message, 'markers', [])]
    assert headers, 'a message with a frame has a header'
    for header in headers:
        assert header.frame_id == frames[row.frame]
        assert nanoseconds(header.stamp) > 0


def test_every_node_reports_on_diagnostics_with_names_that_tools_can_group(
    shared_graph: Graph, stack: Stack
) -> None:
    received = shared_graph.collect('/diagnostics', DiagnosticArray)

    def names() -> set[str]:
        return {status.name for message in received for status in message.status}

    expected = {
        'flock_sim: episode', 'flock_sim: commands', 'lidar: lidar', 'lidar_b: lidar',
        'strombom: controller', 'metrics: metrics', 'policy: policy',
    }  # fmt: skip
    shared_graph.until(lambda: names() >= expected, 'diagnostics of every node')
    assert names() == expected
    for message in received:
        assert message.header.stamp.sec > 1_600_000_000  # wall time, as their tools expect
        for status in message.status:
            assert status.message
            assert status.hardware_id.startswith('shepherd_ros ')


# --- parameters ---------------------------------------------------------------------------------


def options_of(executable: str) -> dict[str, Any]:
    """Return the limits of parameters that come from configurations, by name."""
    parts: dict[str, tuple[tuple[str, Any], ...]] = {
        'flock_sim': (
            ('', WorldConfig),
            ('spawn.', SpawnConfig),
            *((f'{name}.', model.config) for name, model in FLOCK_MODELS.items()),
            *((f'{name}.', task) for name, task in TASKS.items()),
        ),
        'lidar': (('', LidarConfig),),
        'strombom': (('', StrombomConfig),),
    }
    return {
        prefix + f.name: f.metadata
        for prefix, config in parts.get(executable, ())
        for f in fields(config)
        if 'doc' in f.metadata
    }


def describe(graph: Graph, node: str) -> dict[str, tuple[Any, Any]]:
    """Return descriptor and value of every parameter of a node, as tools get them."""
    listed = graph.call(f'{node}/list_parameters', ListParameters, ListParameters.Request())
    names = list(listed.result.names)
    described = graph.call(
        f'{node}/describe_parameters', DescribeParameters, DescribeParameters.Request(names=names)
    )
    values = graph.call(
        f'{node}/get_parameters', GetParameters, GetParameters.Request(names=names)
    )
    return {
        name: (descriptor, value)
        for name, descriptor, value in zip(
            names, described.descriptors, values.values, strict=True
        )
        if name not in OF_RCLPY
    }


@pytest.mark.parametrize('node', NODES)
def test_every_parameter_is_described_limited_and_read_only_but_for_those_of_the_world(
    shared_graph: Graph, stack: Stack, node: str
) -> None:
    executable = NODES[node][0]
    described = describe(shared_graph, node)
    options = options_of(executable)
    assert options.keys() <= described.keys()
    assert {'executor', 'frame_id'} <= described.keys()
    changeable = {name for name, (descriptor, _) in described.items() if not descriptor.read_only}
    of_world = options.keys() | {'flock', 'preset', 'rate', 'seed', 'step_size'}
    assert changeable == (of_world if executable == 'flock_sim' else set())
    for name, (descriptor, value) in described.items():
        assert descriptor.description, name
        assert descriptor.type == value.type
        ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
        if name in options:
            option = options[name]
            assert descriptor.description == option['doc']
            bounded = option['low'] is not None or option['high'] is not None
            assert len(ranges) == int(bounded), name
            for side, limit in (('from_value', option['low']), ('to_value', option['high'])):
                if limit is not None:
                    assert getattr(ranges[0], side) == limit, name
            for choice in option['choices'] or ():
                assert choice in descriptor.additional_constraints, name
        elif value.type in (ParameterType.PARAMETER_INTEGER, ParameterType.PARAMETER_DOUBLE):
            assert len(ranges) == 1, f'{name} has no limits'
        for limits in ranges:
            number = value.integer_value or value.double_value
            assert limits.from_value <= number <= limits.to_value, name
            assert limits.step == 0, name
    for name in {'executor', 'mode', 'flock', 'preset'} & described.keys():
        assert described[name][0].additional_constraints.startswith('one of '), name


def test_a_change_that_cannot_be_is_refused_with_a_reason(
    shared_graph: Graph, stack: Stack
) -> None:
    for node, name, value, pattern in (
        ('flock_sim', 'rate', -1.0, 'rate out of range'),
        ('flock_sim', 'rate', 1e9, 'rate out of range'),
        ('flock_sim', 'mode', 'realtime', 'mode'),
        ('flock_sim', 'spawn.flock_distance_min', 99.0, 'expected at most flock_distance_max'),
        ('flock_sim', 'spawn.fewest_shepherds', 99, 'expected at most n_shepherds'),
        ('flock_sim', 'flock', 'goats', 'expected one of'),
        ('flock_sim', 'preset', 'none', 'expected one of'),
        ('flock_sim', 'n_sheep', -5, 'n_sheep'),
        ('lidar', 'n_rays', 64, 'n_rays'),
        ('lidar_b', 'shepherd_ids', [0], 'shepherd_ids'),
        ('strombom', 'noise', 0.1, 'noise'),
        ('metrics', 'frame_id', 'odom', 'frame_id'),
    ):
        before = describe(shared_graph, node)[name][1]
        taken, reason = shared_graph.set_parameter(node, name, value)
        assert not taken
        assert pattern in reason
        assert describe(shared_graph, node)[name][1] == before


def test_the_presets_change_the_defaults_that_a_node_shows(graph: Graph) -> None:
    node = graph.host('flock_sim', preset='metric_attraction', n_sheep=5)
    expected = world_preset('metric_attraction')
    for name in ('sheep_range', 'metric_attraction', 'cohesion'):
        value = node.get_parameter(f'strombom.{name}').value
        assert value == getattr(expected.flock, name)
    assert node.world.flock == expected.flock
    other = graph.host(
        'flock_sim', '-r', '__node:=other', preset='fine_dt', n_sheep=5,
        **{'strombom.cohesion': 2.0},
    )  # fmt: skip
    assert (other.world.dt, other.world.flock.cohesion) == (0.1, 2.0)
