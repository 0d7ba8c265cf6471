"""
Messages between the nodes of one process, straight from publisher to callback.

What intra-process communication is to rclcpp, and rclpy lacks. A message goes to everybody over
the transport or to everybody over DDS, so nobody hears it twice and no other process misses it.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy
from rclpy.subscription import Subscription

CALLBACKS_PER_TURN = 64  # callbacks between two looks of the executor at timers and DDS

Key = tuple[str, Any]  # topic and type


def endpoint_key(end: Publisher | Subscription) -> Key:
    """Return topic and type, by which publishers and subscriptions are matched."""
    return end.topic_name, end.msg_type


class IntraProcessSubscription:
    """A raw subscription in this process, with a queue of messages as deep as that in DDS."""

    def __init__(self, subscription: Subscription) -> None:
        """Begin with nothing heard."""
        self.subscription = subscription
        self.callback = subscription.callback
        self.waiting: deque[bytes] = deque(maxlen=subscription.qos_profile.depth)


class IntraProcessTransport:
    """Subscriptions of this process by topic and type, and the messages on their way."""

    def __init__(self) -> None:
        """Start with nobody."""
        self.readers: defaultdict[Key, list[IntraProcessSubscription]] = defaultdict(list)
        self.version = 0  # of readers
        self.queue: deque[IntraProcessSubscription] = deque()  # whose turn it is
        self.task: Callable[[Callable[[], None]], Any] | None = None
        self.delivered = 0  # messages so far
        self.failure: Exception | None = None

    def add(self, subscription: Subscription) -> None:
        """Add a raw subscription to the readers of this process."""
        self.readers[endpoint_key(subscription)].append(IntraProcessSubscription(subscription))
        self.version += 1

    def remove(self, subscription: Subscription) -> None:
        """Remove a subscription, with what is on its way to it."""
        readers = self.readers[endpoint_key(subscription)]
        for reader in [reader for reader in readers if reader.subscription is subscription]:
            readers.remove(reader)
            reader.waiting.clear()
        self.version += 1

    def deliver(self, readers: list[IntraProcessSubscription], message: bytes) -> None:
        """Have a message delivered to all of these in its turn."""
        self.delivered += 1
        idle = not self.queue
        for reader in readers:
            reader.waiting.append(message)
        self.queue.extend(readers)
        if idle:
            self._go_on()

    def deliver_by(self, task: Callable[[Callable[[], None]], Any] | None) -> None:
        """Deliver as tasks of an executor from now on; None: keep all until there is one."""
        self.task = task
        self._go_on()

    def check(self) -> None:
        """Raise what a callback has raised: an events executor does not survive it in a task."""
        failure, self.failure = self.failure, None
        if failure is not None:
            raise failure

    def _go_on(self) -> None:
        if self.queue and self.task is not None:
            self.task(self._deliver)

    def _deliver(self) -> None:
        """Call back for what waits, in its order; what is too much waits for the next turn."""
        for _ in range(CALLBACKS_PER_TURN):
            if not self.queue:
                return
            reader = self.queue.popleft()
            if reader.waiting:  # else it was dropped, as DDS would
                try:
                    reader.callback(reader.waiting.popleft())
                except Exception as error:
                    self.failure = error
                    return
        self._go_on()


class IntraProcessPublisher:
    """A publisher that leaves out DDS while all its readers are in this process."""

    def __init__(self, node: Node, publisher: Publisher, transport: IntraProcessTransport) -> None:
        """Stand before a publisher of a node."""
        self.node, self.publisher, self.transport = node, publisher, transport
        self.key = endpoint_key(publisher)
        # latched messages have to be there for those who come later
        self.may = publisher.qos_profile.durability == DurabilityPolicy.VOLATILE
        self.found: tuple[int, int] = (0, -1)  # subscriptions and version for which alone holds
        self.alone = False

    def __getattr__(self, name: str) -> Any:
        """Return what the publisher itself has."""
        return getattr(self.publisher, name)

    def publish(self, message: Any) -> None:
        """Publish a message, or one as bytes, which may take the transport."""
        raw = self.may and isinstance(message, bytes)
        readers = self.transport.readers.get(self.key) if raw else None
        if readers and self._alone(readers):
            self.transport.deliver(readers, message)
        else:
            self.publisher.publish(message)

    def _alone(self, readers: list[IntraProcessSubscription]) -> bool:
        """Return whether nobody else hears this publisher, as far as DDS knows."""
        now = self.publisher.get_subscription_count(), self.transport.version
        if now != self.found:
            # the same number may be others, while some of ours are not matched yet
            known = self.node.get_subscriptions_info_by_topic(self.publisher.topic_name)
            self.found, self.alone = now, now[0] == len(known) == len(readers)
        return self.alone


Output = Publisher | IntraProcessPublisher
