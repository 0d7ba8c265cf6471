"""A process with one node that looks for another: python -m ... OWN OTHER prints JSON."""

from __future__ import annotations

import json
import os
import sys
import time

import rclpy
from rclpy.node import Node
from shepherd_ros.config import ConfigError
from shepherd_ros.ros.runtime import init_rclpy
from std_msgs.msg import String

_PREFIX = 'shepherd_doctor_'
_LIMIT = 15.0  # [s] in which the other is heard, or is not there
SAYING = 2.0  # [s] that this one goes on after it has heard the other
_PERIOD = 0.05  # [s] between two messages
_SIZE = 20_000  # [bytes] of a message, about a scan of 5,000 rays


def main(own: str, other: str) -> int:
    """Look for the other; print what was found as JSON; return the exit code."""
    try:
        init_rclpy()
    except ConfigError as error:
        print(json.dumps({'error': str(error), 'setting': True}))
        return 2
    node = Node(f'{_PREFIX}{own}_{os.getpid()}', start_parameter_services=False)
    started, delays = time.monotonic(), list[float]()

    def on_message(message: String) -> None:
        if len(message.data) == _SIZE:
            delays.append(time.monotonic() - started)

    group = f'_{_PREFIX}{os.getppid()}'  # of the one who asks, and of nobody else
    node.create_subscription(String, f'{group}/{other}', on_message, 10)
    output = node.create_publisher(String, f'{group}/{own}', 10)
    message_out, limit = String(data='x' * _SIZE), started + _LIMIT
    while time.monotonic() < limit:
        output.publish(message_out)
        rclpy.spin_once(node, timeout_sec=_PERIOD)
        if delays:
            limit = min(limit, started + delays[0] + SAYING)
    names = {f'{space.rstrip("/")}/{name}' for name, space in node.get_node_names_and_namespaces()}
    found = {
        'rmw': rclpy.get_rmw_implementation_identifier(),
        'distro': os.environ.get('ROS_DISTRO', ''),
        'domain': os.environ.get('ROS_DOMAIN_ID') or '0',
        'seconds': delays[0] if delays else None,
        'others': sorted(name for name in names if not name.startswith(f'/{_PREFIX}')),
    }
    node.destroy_node()
    rclpy.try_shutdown()
    print(json.dumps(found))
    return 0


if __name__ == '__main__':
    sys.exit(main(*sys.argv[1:]))
