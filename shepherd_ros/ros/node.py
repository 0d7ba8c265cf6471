"""Base class of nodes: topics from the contract, parameters from options, diagnostics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from importlib import import_module
import time
from typing import Any, ClassVar

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from shepherd_ros import __version__
from shepherd_ros.ros.intra_process import IntraProcessPublisher, IntraProcessTransport, Output
from shepherd_ros.ros.parameters import declare, ParameterNode
from shepherd_ros.ros.topic_types import one_type
from shepherd_ros.wire.decode import CdrError, DECODERS
from shepherd_ros.wire.topics import CLOCK, contract, row_of, SHEPHERD, Topic, WORLD_FRAME

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
EXECUTORS = ('events', 'single')
PUBLISHER_CHECK_PERIOD = 0.2  # [s] between two checks of topics that one node alone may publish
UNKNOWN_NODE_NAME = '_NODE_NAME_UNKNOWN_'  # of a publisher whose node DDS has not discovered yet


def message_type(name: str) -> Any:
    """Return the class of a type such as geometry_msgs/msg/PoseArray."""
    package, kind, message = name.split('/')
    return getattr(import_module(f'{package}.{kind}'), message)


def quality(topic: str, subscribe: bool = False) -> QoSProfile:
    """Return the quality of service of a topic, for a publisher or a subscriber."""
    profile = contract()[1][row_of(topic).profile]
    reliability = (profile.subscribe if subscribe else '') or profile.reliability
    return QoSProfile(
        depth=profile.depth,
        reliability=ReliabilityPolicy[reliability.upper()],
        durability=DurabilityPolicy[profile.durability.upper()],
    )


class ShepherdNode(ParameterNode):
    """A node with topics from the contract and a report on /diagnostics every second."""

    backlog: ClassVar[int] = (
        0  # least depth of its subscriptions' queues, where the profile has less
    )

    def __init__(
        self, name: str, *, transport: IntraProcessTransport | None = None, **kwargs: Any
    ) -> None:
        """Create the node; nodes of a process may share a transport. kwargs are rclpy's."""
        super().__init__(name, **kwargs)
        self.transport = transport
        self.finished = False  # a node sets this to end its process
        self.unreadable: Counter[str] = Counter()  # messages that could not be decoded, by topic
        self.exclusive_topics: set[str] = set()  # topics of this node that one node may publish
        self.rivals: dict[str, list[str]] = {}  # nodes that publish such a topic, if several do
        self.had_faults = False  # whether messages or rivals were ever wrong
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.frame_id: str = self.option('frame_id', WORLD_FRAME, 'name of the world frame')
        self.executor_kind: str = self.option(
            'executor', 'events', 'executor: events (experimental in Jazzy), or single (slower)',
            choices=EXECUTORS,
        )  # fmt: skip
        # several worlds share /tf: the frames of each begin with its namespace
        self.shepherd_frame = f'{self.get_namespace()}/{SHEPHERD}'.lstrip('/')
        self._diagnostics = self.advertise('/diagnostics')
        self.timer(1.0, self.publish_diagnostics)
        self.timer(PUBLISHER_CHECK_PERIOD, self.find_rivals)
        if self.get_parameter('use_sim_time').value:
            self.exclusive_topics.add(CLOCK)

    def option(
        self, name: str, default: Any, doc: str, read_only: bool = True, **limits: Any
    ) -> Any:
        """Declare one parameter and return its value."""
        return declare(self, name, default, {'doc': doc, **limits}, read_only)

    def advertise(self, topic: str, shepherd: int | None = None, kind: str = '') -> Output:
        """Return a publisher of a topic of the contract; kind is its alternative type."""
        row = row_of(topic)
        name, kind = topic.format(h=shepherd), kind or row.type
        with one_type(name, kind):
            publisher = self.create_publisher(message_type(kind), name, quality(topic))
        self._watch_publishers(row, publisher)
        return (
            publisher
            if self.transport is None
            else IntraProcessPublisher(self, publisher, self.transport)
        )

    def listen(
        self,
        topic: str,
        callback: Callable[[Any], None],
        shepherd: int | None = None,
        *,
        kind: str = '',
        decode: Callable[[bytes], Any] | None = None,
        name: str = '',
    ) -> Subscription:
        """
        Return a subscription to a topic of the contract, or to another one by name that is alike.

        callback(content) receives what decode(message) returns, as in wire.decode by default.
        """
        row = row_of(topic)
        kind = kind or row.type
        decode = decode or DECODERS[kind]
        name = name or topic.format(h=shepherd)
        profile = quality(topic, subscribe=True)
        profile.depth = max(profile.depth, self.backlog)

        def receive(raw: bytes) -> None:
            try:
                content = decode(raw)
            except CdrError as error:
                self.unreadable[name] += 1
                self.get_logger().warning(
                    f'{name} has a message that cannot be read ({error}): ignored',
                    throttle_duration_sec=5.0,
                )
            else:
                callback(content)

        with one_type(name, kind):
            subscription = self.create_subscription(
                message_type(kind), name, receive, profile, raw=True
            )
        self._watch_publishers(row, subscription)
        if self.transport is not None:
            self.transport.add(subscription)
        return subscription

    def _watch_publishers(self, row: Topic, end: Publisher | Subscription) -> None:
        """Check the publishers of a topic that one executable publishes, and no user."""
        if len(row.publisher) == 1 and row.publisher != ('user',):
            self.exclusive_topics.add(end.topic_name)

    def destroy_publisher(self, publisher: Output) -> bool:
        """Destroy a publisher of advertise(); return whether it existed."""
        if isinstance(publisher, IntraProcessPublisher):
            publisher = publisher.publisher
        self.exclusive_topics.discard(publisher.topic_name)
        return bool(super().destroy_publisher(publisher))

    def destroy_subscription(self, subscription: Subscription) -> bool:
        """Destroy a subscription of listen(); return whether it existed."""
        self.exclusive_topics.discard(subscription.topic_name)
        if self.transport is not None:
            self.transport.remove(subscription)
        return bool(super().destroy_subscription(subscription))

    def timer(self, period: float, callback: Callable[[], None]) -> Timer:
        """Return a timer with a period in wall time [s], also with a simulated clock."""
        return self.create_timer(period, callback, clock=self.steady)

    def wall(self) -> float:
        """Return the time of a monotonic wall clock [s]."""
        return time.monotonic()

    def serve(self) -> None:
        """Open the servers of the node; not called for help or documentation."""

    def end(self) -> int:
        """Finish the work of the node and return the exit code of the process."""
        return 0

    def diagnose(self) -> list[DiagnosticStatus]:
        """Return the statuses for /diagnostics."""
        return [self.status('node', OK, 'running')]

    def publishers_of(self, topic: str) -> list[str]:
        """Return the full names of the nodes that publish a topic, sorted."""
        return sorted(
            'a node not yet named'
            if info.node_name == UNKNOWN_NODE_NAME
            else f'{info.node_namespace.rstrip("/")}/{info.node_name}'
            for info in self.get_publishers_info_by_topic(topic)
        )

    def sourced(self, topic: str) -> str:
        """Return a topic with the nodes that publish it."""
        return f'{topic} ({", ".join(self.publishers_of(topic)) or "nobody publishes it"})'

    def find_rivals(self) -> None:
        """Log the nodes that share a topic that only one may publish, once per set of nodes."""
        contested = [
            name for name in sorted(self.exclusive_topics) if self.count_publishers(name) > 1
        ]
        rivals = {name: self.publishers_of(name) for name in contested}
        if rivals == self.rivals:
            return
        for name, writers in rivals.items():
            if self.rivals.get(name) != writers:
                self.get_logger().error(
                    f'{name} is published by {len(writers)} nodes ({", ".join(writers)}), '
                    'expected one: stop the others, or give each world a namespace of its own '
                    'and all but one publish_clock:=false'
                )
        self.rivals, self.had_faults = rivals, True
        self.on_rivals()

    def on_rivals(self) -> None:
        """React to a change of the rivals; nothing by default."""

    def diagnose_inputs(self) -> list[DiagnosticStatus]:
        """Return the status of rivals and unreadable messages; empty if there never were any."""
        level, message = OK, 'every message can be read'
        if self.rivals:
            level, message = ERROR, 'several nodes publish ' + ', '.join(self.rivals)
        elif self.unreadable:
            level, message = WARN, 'cannot be read: ' + ', '.join(sorted(self.unreadable))
        shown = [self.status('inputs', level, message, **self.unreadable)]
        return shown if self.had_faults or self.unreadable else []

    def status(self, part: str, level: bytes, message: str, **values: Any) -> DiagnosticStatus:
        """Return one status, named as by diagnostic_updater."""
        return DiagnosticStatus(
            name=f'{self.get_fully_qualified_name().lstrip("/")}: {part}',
            level=level,
            message=message,
            hardware_id=f'shepherd_ros {__version__}',
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )

    def publish_diagnostics(self) -> None:
        """Publish diagnose(); the stamp is wall time, as diagnostics tools expect."""
        message = DiagnosticArray(status=self.diagnose() + self.diagnose_inputs())
        message.header.stamp = Clock(clock_type=ClockType.SYSTEM_TIME).now().to_msg()
        self._diagnostics.publish(message)


def nanoseconds(stamp: Any) -> int:
    """Return a builtin_interfaces/Time as nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def stamp(ns: int) -> Any:
    """Return nanoseconds as a builtin_interfaces/Time."""
    return Time(sec=ns // 1_000_000_000, nanosec=ns % 1_000_000_000)
