"""Composition of several nodes in one process: the same node classes, without DDS between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from shepherd_ros.bringup import Process
from shepherd_ros.controllers import CONTROLLERS
from shepherd_ros.nodes.flock_node import FlockSim
from shepherd_ros.nodes.heuristic_node import HeuristicNode
from shepherd_ros.nodes.lidar_node import LidarNode
from shepherd_ros.nodes.metrics_node import MetricsNode
from shepherd_ros.nodes.mux_node import MuxNode
from shepherd_ros.nodes.policy_node import PolicyNode
from shepherd_ros.ros.intra_process import IntraProcessTransport
from shepherd_ros.ros.node import ShepherdNode


def console(**kwargs: Any) -> ShepherdNode:
    """Return the console, whose server (tornado) the other nodes do not need."""
    from shepherd_ros.nodes.console_node import ConsoleNode

    return ConsoleNode(**kwargs)


NODES: dict[str, Callable[..., ShepherdNode]] = {
    'flock_sim': FlockSim,
    'lidar': LidarNode,
    'metrics': MetricsNode,
    'mux': MuxNode,
    'console': console,
    **{kind.executable: partial(HeuristicNode, name) for name, kind in CONTROLLERS.items()},
    'controller': HeuristicNode,
    'policy': PolicyNode,
}


def compose(processes: Sequence[Process], **kwargs: Any) -> list[ShepherdNode]:
    """
    Return the nodes of a stack, to be spun together with ros.runtime.spin().

    Messages among these nodes alone bypass DDS; subscribers of other processes get theirs by DDS.
    Keyword arguments are those of rclpy's Node, such as a context. The executor is that of the
    first node.
    """
    transport = IntraProcessTransport()
    return [
        NODES[process.executable](
            cli_args=process.arguments(),
            transport=transport,
            **({'use_global_arguments': False} | kwargs),
        )
        for process in processes
    ]
