"""Subscriptions whose messages are taken by hand, which costs less than a callback for each."""

from __future__ import annotations

from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.subscription import Subscription
from shepherd_ros.ros.node import message_type, quality
from shepherd_ros.wire.topics import row_of

MOST_AT_ONCE = 100  # messages of a topic that are taken in one look


class PolledGroup(CallbackGroup):
    """
    Subscriptions whose messages no executor takes: that would cost more than to use them.

    Their events, by which DDS reports losses, make every round of an executor milliseconds long:
    it sees them only while the group is open.
    """

    open = False

    def can_execute(self, entity: Any) -> bool:
        """Return whether the executor may care for something."""
        return self.open and not isinstance(entity, Subscription)

    def beginning_execution(self, entity: Any) -> bool:
        """Return that there is nothing to wait for."""
        return True

    def ending_execution(self, entity: Any) -> None:
        """Do nothing."""


def never(raw: bytes) -> None:
    """Stand for the callback of a subscription whose messages are taken by hand."""


class PolledTopic:
    """A topic of the contract of which only the newest messages are kept, until they are taken."""

    def __init__(
        self, node: Node, group: PolledGroup, topic: str, shepherd: int = 0, depth: int = 1
    ) -> None:
        """Subscribe; depth is how many messages are kept."""
        profile = quality(topic, subscribe=True)
        profile.depth = depth
        self.node, self.name = node, topic.format(h=shepherd)
        self._subscription = node.create_subscription(
            message_type(row_of(topic).type),
            self.name,
            never,
            profile,
            callback_group=group,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )

    def take(self) -> list[bytes]:
        """Return the messages that have come since the last look, the newest last."""
        handle, kind = self._subscription.handle, self._subscription.msg_type
        messages: list[bytes] = []
        try:
            with handle:
                while (taken := handle.take_message(kind, True)) is not None:
                    messages.append(taken[0])
                    if len(messages) > MOST_AT_ONCE:
                        break
        except InvalidHandle:  # it is closed
            pass
        return messages

    def close(self) -> None:
        """Subscribe no more."""
        self.node.destroy_subscription(self._subscription)
