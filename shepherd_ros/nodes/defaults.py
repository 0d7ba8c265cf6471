"""The parameter files of config/, written from the nodes themselves."""

from __future__ import annotations

import rclpy
from rclpy.context import Context
from rclpy.parameter import parameter_value_to_python
from shepherd_ros.nodes.compose import NODES
import yaml

WITH_FILE = ('flock_sim', 'lidar', 'metrics', 'strombom', 'pierson', 'drover', 'policy')


def parameter_file(name: str) -> str:
    """Return a parameter file with every default of a node and what it means."""
    context = Context()
    rclpy.init(args=[], context=context)
    node = NODES[name](context=context)
    lines = [
        f'# Every parameter of {name} with its default.',
        f'/**/{name}:',
        '  ros__parameters:',
    ]
    for key in sorted(node._parameters):
        text = node.describe_parameter(key).description
        if text and key not in ('use_sim_time', 'start_type_description_service'):
            value = parameter_value_to_python(node.get_parameter(key).get_parameter_value())
            value = value if isinstance(value, bool | int | float | str) else list(value)
            shown = yaml.safe_dump(value, default_flow_style=True).removesuffix('\n...\n').strip()
            lines += [f'    # {text}', f'    {key}: {shown}']
    node.destroy_node()
    context.try_shutdown()
    return '\n'.join(lines) + '\n'
