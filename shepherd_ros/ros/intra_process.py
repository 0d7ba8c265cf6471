"""
Messages between the nodes of one process, straight from publisher to callback.

The intra-process communication of rclcpp, which rclpy lacks. A message goes to all readers over
the transport or to all over DDS, so none receives it twice and no other process misses it.
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
    """Return topic and type of a publisher or a subscription, by which they are matched."""
    return end.topic_name, end.msg_type


class IntraProcessSubscription:
    """A raw subscription in this process, with a queue of messages as deep as that in DDS."""

    def __init__(self, subscription: Subscription) -> None:
        """Start with an empty queue."""
        self.subscription = subscription
        self.callback = subscription.callback
        self.waiting: deque[bytes] = deque(maxlen=subscription.qos_profile.depth)


class IntraProcessTransport:
    """Subscriptions of this process by topic and type, and their queued messages."""

    def __init__(self) -> None:
        """Start without subscriptions."""
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
        """Remove a subscription, with the messages queued for it."""
        readers = self.readers[endpoint_key(subscription)]
        for reader in [reader for reader in readers if reader.subscription is subscription]:
            readers.remove(reader)
            reader.waiting.clear()
        self.version += 1

    def deliver(self, readers: list[IntraProcessSubscription], message: bytes) -> None:
        """Queue a message for these readers."""
        self.delivered += 1
        idle = not self.queue
        for reader in readers:
            reader.waiting.append(message)
        self.queue.extend(readers)
        if idle:
            self._schedule()

    def deliver_with(self, task: Callable[[Callable[[], None]], Any] | None) -> None:
        """Deliver as tasks of an executor from now on; None: keep messages until there is one."""
        self.task = task
        self._schedule()

    def raise_failure(self) -> None:
        """Raise the exception of a callback: an events executor does not survive it in a task."""
        failure, self.failure = self.failure, None
        if failure is not None:
            raise failure

    def _schedule(self) -> None:
        if self.queue and self.task is not None:
            self.task(self._deliver)

    def _deliver(self) -> None:
        """Call back for queued messages in order, at most CALLBACKS_PER_TURN at a time."""
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
        self._schedule()


class IntraProcessPublisher:
    """A publisher that bypasses DDS while all its readers are in this process."""

    def __init__(self, node: Node, publisher: Publisher, transport: IntraProcessTransport) -> None:
        """Wrap a publisher of a node."""
        self.node, self.publisher, self.transport = node, publisher, transport
        self.key = endpoint_key(publisher)
        # latched messages have to be there for those who come later
        self.allows_transport = publisher.qos_profile.durability == DurabilityPolicy.VOLATILE
        self.matched: tuple[int, int] = (0, -1)  # subscriptions and version, of all_local
        self.all_local = False

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the wrapped publisher."""
        return getattr(self.publisher, name)

    def publish(self, message: Any) -> None:
        """Publish a message; one as bytes may take the transport."""
        raw = self.allows_transport and isinstance(message, bytes)
        readers = self.transport.readers.get(self.key) if raw else None
        if readers and self._is_local(readers):
            self.transport.deliver(readers, message)
        else:
            self.publisher.publish(message)

    def _is_local(self, readers: list[IntraProcessSubscription]) -> bool:
        """Return whether these are all readers of this publisher, as far as DDS knows."""
        current = self.publisher.get_subscription_count(), self.transport.version
        if current != self.matched:
            # the same number may be others, while some of ours are not matched yet
            subscriptions = self.node.get_subscriptions_info_by_topic(self.publisher.topic_name)
            self.matched, self.all_local = (
                current,
                current[0] == len(subscriptions) == len(readers),
            )
        return self.all_local


Output = Publisher | IntraProcessPublisher
