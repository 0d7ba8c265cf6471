"""
Messages between the nodes of one process, straight from publisher to callback.

What intra-process communication is to rclcpp, and rclpy lacks. A message goes to everybody over
the bus or to everybody over DDS, so nobody hears it twice and no other process misses it.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy
from rclpy.subscription import Subscription

TURN = 64  # callbacks between two looks of the executor at timers and DDS

Key = tuple[str, Any]  # topic and type


def key_of(end: Publisher | Subscription) -> Key:
    """Return what publishers and subscriptions that belong together have in common."""
    return end.topic_name, end.msg_type


class Ear:
    """A raw subscription on the bus, and what waits for it: as much as its queue in DDS keeps."""

    def __init__(self, subscription: Subscription) -> None:
        """Begin with nothing heard."""
        self.subscription = subscription
        self.callback = subscription.callback
        self.waiting: deque[bytes] = deque(maxlen=subscription.qos_profile.depth)


class Bus:
    """Who hears what in this process, and the messages on their way."""

    def __init__(self) -> None:
        """Start with nobody."""
        self.ears: defaultdict[Key, list[Ear]] = defaultdict(list)
        self.version = 0  # of ears
        self.queue: deque[Ear] = deque()  # whose turn it is
        self.task: Callable[[Callable[[], None]], Any] | None = None
        self.carried = 0  # messages so far
        self.failure: Exception | None = None

    def hear(self, subscription: Subscription) -> None:
        """Let a raw subscription hear the publishers of this process."""
        self.ears[key_of(subscription)].append(Ear(subscription))
        self.version += 1

    def forget(self, subscription: Subscription) -> None:
        """Let a subscription hear no more, not even what is on its way."""
        ears = self.ears[key_of(subscription)]
        for ear in [ear for ear in ears if ear.subscription is subscription]:
            ears.remove(ear)
            ear.waiting.clear()
        self.version += 1

    def carry(self, ears: list[Ear], message: bytes) -> None:
        """Have a message delivered to all of these in its turn."""
        self.carried += 1
        idle = not self.queue
        for ear in ears:
            ear.waiting.append(message)
        self.queue.extend(ears)
        if idle:
            self._go_on()

    def spun(self, task: Callable[[Callable[[], None]], Any] | None) -> None:
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
        for _ in range(TURN):
            if not self.queue:
                return
            ear = self.queue.popleft()
            if ear.waiting:  # else it was dropped, as DDS would
                try:
                    ear.callback(ear.waiting.popleft())
                except Exception as error:
                    self.failure = error
                    return
        self._go_on()


class LocalPublisher:
    """A publisher that takes the bus while all who hear it are on it; else one as any other."""

    def __init__(self, node: Node, publisher: Publisher, bus: Bus) -> None:
        """Stand before a publisher of a node."""
        self.node, self.publisher, self.bus = node, publisher, bus
        self.key = key_of(publisher)
        # latched messages have to be there for those who come later
        self.may = publisher.qos_profile.durability == DurabilityPolicy.VOLATILE
        self.found: tuple[int, int] = (0, -1)  # subscriptions and version for which alone holds
        self.alone = False

    def __getattr__(self, name: str) -> Any:
        """Return what the publisher itself has."""
        return getattr(self.publisher, name)

    def publish(self, message: Any) -> None:
        """Publish a message, or one as bytes, which may take the bus."""
        ears = self.bus.ears.get(self.key) if self.may and isinstance(message, bytes) else None
        if ears and self._alone(ears):
            self.bus.carry(ears, message)
        else:
            self.publisher.publish(message)

    def _alone(self, ears: list[Ear]) -> bool:
        """Return whether nobody else hears this publisher, as far as DDS knows."""
        now = self.publisher.get_subscription_count(), self.bus.version
        if now != self.found:
            # the same number may be others, while some of ours are not matched yet
            known = self.node.get_subscriptions_info_by_topic(self.publisher.topic_name)
            self.found, self.alone = now, now[0] == len(known) == len(ears)
        return self.alone


Output = Publisher | LocalPublisher
