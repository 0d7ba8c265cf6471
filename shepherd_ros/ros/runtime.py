"""Process of a node: start, spin, and end with a message and an exit code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import faulthandler
from functools import partial
import gc
import os
import re
import signal
import sys
from threading import Timer
from typing import Any

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor

# Jazzy has no public name for the errors of rcl
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.parameter import parameter_value_to_python
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from shepherd_ros.config import ConfigError
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.ros.parameters import warn_of_unknown

EXIT_USAGE = 2
LAST_DOMAIN = 232  # the ports of the next are too high
SIGNAL_POLL_PERIOD = 0.1  # [s] after which a signal is seen at the latest
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
DDS_SHUTDOWN_TIMEOUT = 10.0  # [s] for the shutdown of DDS after the end of all work


def make_executor(kind: str, context: Any = None) -> Executor:
    """Return an executor: events (experimental in Jazzy), or single (slower)."""
    if kind == 'events':
        from rclpy.experimental.events_executor import EventsExecutor

        return EventsExecutor(context=context)
    return SingleThreadedExecutor(context=context)


def spin(nodes: Sequence[ShepherdNode], until: Callable[[], bool] = lambda: False) -> None:
    """Run nodes in one executor until the context ends or until() is true."""
    context = nodes[0].context
    executor = make_executor(nodes[0].executor_kind, context)
    for node in nodes:
        executor.add_node(node)
    transports = {
        id(node.transport): node.transport for node in nodes if node.transport is not None
    }.values()
    for transport in transports:
        transport.deliver_with(executor.create_task)
    try:
        # a time-out, as the events executor of Jazzy hangs without one
        while context.ok() and not until():
            executor.spin_once(timeout_sec=SIGNAL_POLL_PERIOD)
            for transport in transports:
                transport.raise_failure()
    finally:
        for transport in transports:
            transport.deliver_with(None)
        for node in nodes:
            executor.remove_node(node)
        executor.shutdown(timeout_sec=1.0)


def help_text(node: ShepherdNode, doc: str) -> str:
    """Return the help of a node: its purpose, and its parameters with their defaults."""
    lines = [doc.strip(), '', 'Parameters (--ros-args -p name:=value, or --params-file FILE):']
    for name in sorted(node.list_parameters([], 0).names):
        described = node.describe_parameter(name)
        value = parameter_value_to_python(node.get_parameter(name).get_parameter_value())
        if described.description and not name.startswith(('qos_overrides', 'start_type_desc')):
            lines.append(f'  {name} ({value}): {described.description}')
    return '\n'.join(lines)


def show_help(node: ShepherdNode, doc: str) -> None:
    """Print the help; a closed pipe, as of head, is no error."""
    try:
        print(help_text(node, doc), flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def disable_discovery() -> None:
    """Turn discovery and logs of this process off, for nodes that only print their help."""
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'OFF'
    set_logger_level('', LoggingSeverity.FATAL)


def run(make_node: Callable[..., Any], name: str, doc: str, options: Any = None) -> int:
    """
    Run a node as a process; return its exit code, that of node.end() after a stop signal.

    options is a dataclass filled from the command line, the argument of make_node. Of
    several nodes that this returns, the first one decides when and how all end.
    """
    # rclpy's own handlers would end the context in the midst of a callback that publishes
    received: list[int] = []
    for number in STOP_SIGNALS:
        if (number, signal.getsignal(number)) != (signal.SIGHUP, signal.SIG_IGN):  # nohup's
            signal.signal(number, lambda number, frame: received.append(number))
    nodes, code = list[ShepherdNode](), EXIT_USAGE
    try:
        arguments = remove_ros_args(sys.argv)[1:]
        if options is not None:
            make_node, arguments = partial(make_node, parse_options(options, name, arguments)), []
        unknown = [word for word in arguments if word not in ('-h', '--help')]
        if unknown:
            raise ConfigError(
                f'unknown argument {unknown[0]!r}: expected --help, or --ros-args followed by '
                '-p name:=value, -r from:=to or --params-file FILE'
            )
        if arguments:
            disable_discovery()
        init_rclpy(signal_handler_options=SignalHandlerOptions.NO)
        created = make_node()
        nodes = created if isinstance(created, list) else [created]
        if arguments:
            show_help(nodes[0], doc)
        else:
            for node in nodes:
                warn_of_unknown(node)
                node.serve()
            spin(nodes, until=lambda: nodes[0].finished or bool(received))
        code = 0 if arguments else nodes[0].end()
    except (ConfigError, ParameterException) as error:
        print(f'{name}: {error}', file=sys.stderr)
    except Exception as error:
        message = ros_args_error(error)
        if message is None:
            raise
        print(f'{name}: {message}', file=sys.stderr)
    finally:
        shut_down(nodes, name, code)
        # the end of Python gives handlers up, so a second signal would kill
        for number in STOP_SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        gc.freeze()  # else the end of Python looks through all objects of torch, twice
    return code


def init_rclpy(**options: Any) -> None:
    """Call rclpy.init() with options; ConfigError names the variable that makes it fail."""
    domain = os.environ.get('ROS_DOMAIN_ID', '')
    if domain and not (domain.isdecimal() and int(domain) <= LAST_DOMAIN):
        raise ConfigError(
            f'ROS_DOMAIN_ID is {domain!r}: expected a number from 0 to {LAST_DOMAIN}'
        )
    try:
        rclpy.init(**options)
    except _rclpy.RCLError as error:
        reason = _in_one_line(error)
        if 'initialize logging' in reason:
            raise ConfigError(
                f'{reason}: expected a folder in which logs can be written; set ROS_LOG_DIR to one'
            ) from None
        if os.environ.get('ROS_SECURITY_ENABLE') == 'true':
            keys = os.environ.get('ROS_SECURITY_KEYSTORE', '')
            raise ConfigError(
                f'security is on and ROS_SECURITY_KEYSTORE is {keys!r} ({reason}): expected a '
                'keystore with an enclave of this process; without security set '
                'ROS_SECURITY_ENABLE=false'
            ) from None
        raise


def _in_one_line(error: Exception) -> str:
    """Return the message of an rcl error without the places in its code."""
    return re.sub(r', at \S+:\d+', '', ' '.join(str(error).split()))


def shut_down(nodes: Sequence[ShepherdNode], name: str, code: int) -> None:
    """Destroy nodes and context; end the process with its exit code where DDS hangs."""

    def exit_now() -> None:
        os.write(
            2, f'{name}: DDS did not let go within {DDS_SHUTDOWN_TIMEOUT:g} s: left it\n'.encode()
        )
        os._exit(code)

    timer = Timer(DDS_SHUTDOWN_TIMEOUT, exit_now)
    timer.daemon = True
    timer.start()
    # DDS may hang in a call that keeps the interpreter to itself, where no timer of Python runs
    faulthandler.dump_traceback_later(2 * DDS_SHUTDOWN_TIMEOUT, exit=True, file=2)
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()
    faulthandler.cancel_dump_traceback_later()
    timer.cancel()


def parse_options(options: Any, name: str, words: list[str]) -> Any:
    """Return the options parsed from the arguments of a command line."""
    import tyro  # only nodes with options need it

    return tyro.cli(options, prog=name, args=words)


def ros_args_error(error: Exception) -> str | None:
    """Return the message for a command line or parameter file that rcl refuses, else None."""
    text = _in_one_line(error)
    if isinstance(error, _rclpy.UnknownROSArgsError):
        text = f'unknown words after --ros-args: {text}'
    elif not isinstance(error, _rclpy.RCLInvalidROSArgsError):
        concerns_arguments = 'arg' in text or 'param' in text or 'yaml' in text.lower()
        if not (isinstance(error, _rclpy.RCLError) and concerns_arguments):
            return None
    return f'{text}: check the words after --ros-args and the file of --params-file'
