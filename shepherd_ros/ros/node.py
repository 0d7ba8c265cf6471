"""What all nodes share: topics from the contract, parameters from options, diagnostics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from importlib import import_module
import time
from typing import Any, ClassVar

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from shepherd_ros import __version__
from shepherd_ros.ros.intra_process import IntraProcessPublisher, IntraProcessTransport, Output
from shepherd_ros.ros.parameters import declare, ParameterNode
from shepherd_ros.wire.decode import CdrError, DECODERS
from shepherd_ros.wire.topics import contract, row_of, WORLD_FRAME

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
EXECUTORS = ('events', 'single')


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

    backlog: ClassVar[int] = 0  # messages that wait for it at least, if that is more than usual

    def __init__(
        self, name: str, *, transport: IntraProcessTransport | None = None, **kwargs: Any
    ) -> None:
        """Create the node; nodes of a process may share a transport. kwargs are rclpy's."""
        super().__init__(name, **kwargs)
        self.transport = transport
        self.finished = False  # a node sets this to end its process
        self.unreadable: Counter[str] = Counter()  # messages that could not be decoded, by topic
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.frame_id: str = self.option('frame_id', WORLD_FRAME, 'name of the world frame')
        self.executor_kind: str = self.option(
            'executor', 'events', 'executor: events (experimental in Jazzy), or single (slower)',
            choices=EXECUTORS,
        )  # fmt: skip
        self._diagnostics = self.advertise('/diagnostics')
        self.timer(1.0, self.publish_diagnostics)

    def option(
        self, name: str, default: Any, doc: str, read_only: bool = True, **limits: Any
    ) -> Any:
        """Declare one parameter and return its value."""
        return declare(self, name, default, {'doc': doc, **limits}, read_only)

    def advertise(self, topic: str, shepherd: int | None = None, kind: str = '') -> Output:
        """Return a publisher of a topic of the contract; kind is its alternative type."""
        row = row_of(topic)
        name = topic.format(h=shepherd)
        publisher = self.create_publisher(message_type(kind or row.type), name, quality(topic))
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
    ) -> Subscription:
        """
        Return a subscription to a topic of the contract.

        callback(content) receives what decode(message) returns, as in wire.decode by default.
        """
        kind = kind or row_of(topic).type
        decode = decode or DECODERS[kind]
        name = topic.format(h=shepherd)
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

        subscription = self.create_subscription(
            message_type(kind), name, receive, profile, raw=True
        )
        if self.transport is not None:
            self.transport.add(subscription)
        return subscription

    def destroy_publisher(self, publisher: Output) -> bool:
        """Destroy a publisher that advertise() gave."""
        if isinstance(publisher, IntraProcessPublisher):
            publisher = publisher.publisher
        return bool(super().destroy_publisher(publisher))

    def destroy_subscription(self, subscription: Subscription) -> bool:
        """Destroy a subscription that listen() gave."""
        if self.transport is not None:
            self.transport.remove(subscription)
        return bool(super().destroy_subscription(subscription))

    def timer(self, period: float, callback: Callable[[], None]) -> Timer:
        """Return a timer in wall time [s], whatever the simulated clock does."""
        return self.create_timer(period, callback, clock=self.steady)

    def wall(self) -> float:
        """Return seconds of a wall clock that never jumps."""
        return time.monotonic()

    def end(self) -> int:
        """Finish what was begun and return the exit code of the process."""
        return 0

    def diagnose(self) -> list[DiagnosticStatus]:
        """Return what to tell on /diagnostics."""
        return [self.status('node', OK, 'running')]

    def diagnose_inputs(self) -> DiagnosticStatus:
        """Return what is wrong with messages before anybody looks at what they say."""
        level, message = OK, 'every message can be read'
        if self.unreadable:
            level, message = WARN, 'cannot be read: ' + ', '.join(sorted(self.unreadable))
        return self.status('inputs', level, message, **self.unreadable)

    def status(self, part: str, level: bytes, message: str, **values: Any) -> DiagnosticStatus:
        """Return one status; names are as diagnostic_updater makes them."""
        return DiagnosticStatus(
            name=f'{self.get_fully_qualified_name().lstrip("/")}: {part}',
            level=level,
            message=message,
            hardware_id=f'shepherd_ros {__version__}',
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )

    def publish_diagnostics(self) -> None:
        """Publish what diagnose() says; the stamp is wall time, as diagnostics tools expect."""
        message = DiagnosticArray(status=[*self.diagnose(), self.diagnose_inputs()])
        message.header.stamp = Clock(clock_type=ClockType.SYSTEM_TIME).now().to_msg()
        self._diagnostics.publish(message)


def nanoseconds(stamp: Any) -> int:
    """Return a builtin_interfaces/Time as nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def stamp(ns: int) -> Any:
    """Return nanoseconds as a builtin_interfaces/Time."""
    return Time(sec=ns // 1_000_000_000, nanosec=ns % 1_000_000_000)
