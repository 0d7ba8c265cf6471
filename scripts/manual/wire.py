"""Pages about what nodes say to each other: topics, parameters, services."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import re
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.parameter import parameter_value_to_python
from shepherd_ros import nodes
from shepherd_ros.nodes.compose import NODES
from shepherd_ros.nodes.foxglove_node import FoxgloveNode
from shepherd_ros.nodes.mux_requests import MuxRequests
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.wire.topics import contract, topic_table

from manual.tables import bounds, code, escaped, page, table

FRAMES = """
`{h}` is the index of a shepherd. Names are relative, so namespaces and remaps work.

Frame `world` is the frame named by the parameter `frame_id`, by default `map`.
Frame `shepherd` is `shepherd_<h>`. It moves with its shepherd and never turns.
Frames of the shepherds are on `/tf` where `tf2_msgs` is installed.

A ray without a return is `+inf`, as
[REP 117](https://www.ros.org/reps/rep-0117.html) says.
"""
HIDDEN = ('use_sim_time', 'start_type_description_service')
DOCUMENTED = {**NODES, 'foxglove': FoxgloveNode}  # nodes that have parameters and no options
TYPES = {
    'SetBool': 'std_srvs/srv/SetBool',
    'Trigger': 'std_srvs/srv/Trigger',
}


def topics() -> str:
    """Return the page of the topics."""
    profiles = [
        [code(name), p.reliability, p.durability, str(p.depth), p.subscribe or p.reliability]
        for name, p in contract()[1].items()
    ]
    head = ('quality', 'reliability', 'durability', 'depth', 'reliability of subscribers')
    return page(
        'Topics',
        'Source: `msg_schemas/topics.yaml`, which the nodes read.',
        topic_table(),
        FRAMES,
        '## Quality of service',
        table(head, profiles),
    )


@contextmanager
def quiet_node(name: str) -> Iterator[ShepherdNode]:
    """Lend a node that no other process sees."""
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'OFF'
    set_logger_level('', LoggingSeverity.FATAL)
    context = Context()
    rclpy.init(args=[], context=context)
    node = DOCUMENTED[name](context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        context.try_shutdown()


def _parameter_row(node: ShepherdNode, name: str) -> list[str]:
    """Return the row of a parameter."""
    about = node.describe_parameter(name)
    value = parameter_value_to_python(node.get_parameter(name).get_parameter_value())
    ranges: list[Any] = [*about.integer_range, *about.floating_point_range]
    allowed = bounds(*_limits(ranges[0])) if ranges else ''
    choices = about.additional_constraints.removeprefix('one of ')
    if choices:
        allowed = ', '.join(code(choice) for choice in choices.split(', '))
    shown = value if isinstance(value, bool | int | float | str) else list(value)
    shown = f'{shown:.6g}' if isinstance(shown, float) else shown
    return [code(name), code(shown), allowed, escaped(about.description)]


def _limits(given: Any) -> tuple[Any, Any]:
    """Return low and high, None where there is no real limit."""
    low, high = given.from_value, given.to_value
    return (low if low > -1e12 else None), (high if high < 1e12 else None)


def parameters() -> str:
    """Return the page of the parameters of all nodes."""
    parts = []
    for name in DOCUMENTED:
        with quiet_node(name) as node:
            names = sorted(
                n
                for n in node.list_parameters([], 0).names
                if n not in HIDDEN and node.describe_parameter(n).description
            )
            rows = [_parameter_row(node, n) for n in names]
        parts += [f'## {name}', table(('parameter', 'default', 'allowed', 'meaning'), rows)]
    intro = (
        'Set a parameter with `--ros-args -p name:=value`, or with a file from `config/` and '
        '`--ros-args --params-file FILE`. Parameters are read when a node starts; those of the '
        'world may be set later, and hold from the next episode on. '
        '`recorder`, `player` and `herd` have command-line options: [](commands.md).'
    )
    return page('Parameters', intro, *parts)


def _services_of(path: Path) -> Iterator[list[str]]:
    """Yield a row for each service that a module of nodes makes."""
    text = path.read_text(encoding='utf-8')
    node = path.stem.split('_')[0].replace('flock', 'flock_sim')
    docs = {
        part.name: ast.get_docstring(part) or ''
        for part in ast.walk(ast.parse(text))
        if isinstance(part, ast.FunctionDef)
    }
    for kind, service in re.findall(r"create_service\((\w+), '~/(\w+)'", text):
        meaning = {'start': 'Record.', 'stop': 'Stop recording.'}.get(service) or docs[service]
        yield [code(f'/{node}/{service}'), code(TYPES[kind]), escaped(meaning.splitlines()[0])]


def _services_of_mux() -> Iterator[list[str]]:
    """Yield the rows of mux, whose services have the names of its sources."""
    for name, kind, meaning in (
        ('mux/select/{source}', 'Trigger', MuxRequests.select.__doc__),
        ('shepherd_{h}/mux/{source}', 'Trigger', 'The same for one shepherd.'),
        ('mux/lock', 'SetBool', MuxRequests.lock.__doc__),
        ('shepherd_{h}/mux/lock', 'SetBool', 'The same for one shepherd.'),
    ):
        yield [code(f'/{name}'), code(TYPES[kind]), escaped(meaning)]


def services() -> str:
    """Return the page of the services."""
    files = sorted(Path(nodes.__file__ or '').parent.glob('*.py'))
    rows = [row for path in files for row in _services_of(path)]
    rows += _services_of_mux()
    intro = (
        'Services use standard types only; what they need to know is in parameters. '
        'Examples: [](../how_to/realtime.md).'
    )
    return page('Services', intro, table(('service', 'type', 'meaning'), rows))
