"""Start nodes, spin them, and end with a clear word and the right exit code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import re
import signal
import sys
from typing import Any

import rclpy
from rclpy.exceptions import NotInitializedException, ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.parameter import parameter_value_to_python
from rclpy.utilities import remove_ros_args
from shepherd_ros.config import ConfigError
from shepherd_ros.nodes.base import ShepherdNode
from shepherd_ros.nodes.parameters import warn_of_unknown

USER_MISTAKE = 2
CONTEXT_ENDED = (NotInitializedException, _rclpy.InvalidHandle, _rclpy.RCLError)


def make_executor(kind: str, context: Any = None) -> Executor:
    """Return an executor: single, or events (faster; experimental in Jazzy)."""
    if kind == 'events':
        from rclpy.experimental.events_executor import EventsExecutor

        return EventsExecutor(context=context)
    return SingleThreadedExecutor(context=context)


def spin(nodes: Sequence[ShepherdNode], until: Callable[[], bool] = lambda: False) -> None:
    """Run nodes in one executor until a signal, a shutdown or until() is true."""
    context = nodes[0].context
    executor = make_executor(nodes[0].executor_kind, context)
    for node in nodes:
        executor.add_node(node)
    try:
        # a time-out, as the events executor of Jazzy hangs without one
        while context.ok() and not until():
            executor.spin_once(timeout_sec=0.5)
    finally:
        for node in nodes:
            executor.remove_node(node)
        executor.shutdown(timeout_sec=1.0)


def help_text(node: ShepherdNode, doc: str) -> str:
    """Return what a node does and its parameters with their defaults."""
    lines = [doc.strip(), '', 'Parameters (--ros-args -p name:=value, or --params-file FILE):']
    for name in sorted(node._parameters):
        described = node.describe_parameter(name)
        value = parameter_value_to_python(node.get_parameter(name).get_parameter_value())
        if described.description and not name.startswith(('qos_overrides', 'start_type_desc')):
            lines.append(f'  {name} ({value}): {described.description}')
    return '\n'.join(lines)


def run(make_node: Callable[[], ShepherdNode], name: str, doc: str) -> int:
    """Run one node as a process; return its exit code, 0 after SIGINT or SIGTERM."""
    # both signals end rclpy's context, which ends spin(); KeyboardInterrupt could come anywhere
    signal.signal(signal.SIGINT, lambda *_: None)
    node, started = None, False
    try:
        words = remove_ros_args(sys.argv)[1:]
        strange = [word for word in words if word not in ('-h', '--help')]
        if strange:
            raise ConfigError(
                f'unknown argument {strange[0]!r}: expected --help, or --ros-args followed by '
                '-p name:=value, -r from:=to or --params-file FILE'
            )
        rclpy.init()
        started = True
        node = make_node()
        if words:
            print(help_text(node, doc))
            return 0
        warn_of_unknown(node)
        own = node
        spin([node], until=lambda: own.finished)
    except ExternalShutdownException:
        pass
    except (ConfigError, ParameterException) as error:
        print(f'{name}: {error}', file=sys.stderr)
        return USER_MISTAKE
    except Exception as error:
        if started and not rclpy.ok() and isinstance(error, CONTEXT_ENDED):
            return 0  # a signal came in the middle of a callback
        mistake = rcl_mistake(error)
        if mistake is None:
            raise
        print(f'{name}: {mistake}', file=sys.stderr)
        return USER_MISTAKE
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def rcl_mistake(error: Exception) -> str | None:
    """Return the words for a command line or parameter file that rcl refuses, else None."""
    text = re.sub(r', at \S+:\d+', '', ' '.join(str(error).split()))
    if isinstance(error, _rclpy.UnknownROSArgsError):
        text = f'unknown words after --ros-args: {text}'
    elif not isinstance(error, _rclpy.RCLInvalidROSArgsError):
        about = 'arg' in text or 'param' in text or 'yaml' in text.lower()
        if not (isinstance(error, _rclpy.RCLError) and about):
            return None
    return f'{text}: check the words after --ros-args and the file of --params-file'
