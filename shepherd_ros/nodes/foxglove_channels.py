"""Channels of the Foxglove protocol: topics of the graph, forwarded to the clients that ask."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

from foxglove import Channel, Context, Schema
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription
from shepherd_ros.ros.node import message_type
from shepherd_ros.ros.reader_quality import adapted_quality
from shepherd_ros.wire.schemas import installed_text, nested_text, schema_text, wire_types

ROS2MSG = 'ros2msg'  # encoding of the text of a message type
CDR = 'cdr'  # encoding of messages
DEPTH = 10  # messages of a topic that may wait for the node
EVERY_CLIENT = 0


def message_schema(kind: str) -> Schema:
    """Return the text of a type such as geometry_msgs/msg/PoseArray, with all nested types."""
    text = schema_text(kind) if kind in wire_types() else nested_text(kind, installed_text)
    return Schema(name=kind, encoding=ROS2MSG, data=text.encode())


@dataclass
class BridgedTopic:
    """A topic that clients see, and its subscriptions by client."""

    kind: str
    channel: Channel
    quality: QoSProfile
    clients: set[int] = field(default_factory=set)
    subscriptions: dict[int, Subscription] = field(default_factory=dict)

    @property
    def latched(self) -> bool:
        """Return whether late clients receive messages from before."""
        return bool(self.quality.durability == DurabilityPolicy.TRANSIENT_LOCAL)


class FoxgloveChannels:
    """
    Topics as channels; a topic is subscribed to while a client asks for it.

    A volatile topic has one subscription for all clients. A latched topic has one for each client,
    so that each receives its history once, also a late one.
    """

    def __init__(self, node: Node, context: Context) -> None:
        """Create no channel yet; messages go to the server of the context."""
        self.node, self.context = node, context
        self.topics: dict[str, BridgedTopic] = {}
        self.refused: dict[str, str] = {}
        self.forwarded = 0  # messages

    def look(self, names: list[str]) -> None:
        """Open and close channels so that they are the topics of these names with publishers."""
        offers = {name: self.node.get_publishers_info_by_topic(name) for name in names}
        for name in [*self.topics]:
            if not offers.get(name):
                self._close(name)
        for name, publishers in offers.items():
            if publishers:
                self._meet(name, publishers)

    def subscribe(self, name: str, client: int) -> None:
        """Forward a topic to one more client."""
        topic = self.topics.get(name)
        if topic is None or client in topic.clients:
            return
        topic.clients.add(client)
        key = client if topic.latched else EVERY_CLIENT
        if key not in topic.subscriptions:
            topic.subscriptions[key] = self.node.create_subscription(
                message_type(topic.kind), name, partial(self._forward, topic, key),
                topic.quality, raw=True,
            )  # fmt: skip

    def unsubscribe(self, name: str, client: int) -> None:
        """Forward a topic to one client less."""
        topic = self.topics.get(name)
        if topic is None or client not in topic.clients:
            return
        topic.clients.discard(client)
        key = client if topic.latched else EVERY_CLIENT
        if topic.latched or not topic.clients:
            self.node.destroy_subscription(topic.subscriptions.pop(key))

    def _forward(self, topic: BridgedTopic, client: int, message: bytes) -> None:
        # the server numbers its clients and their queues alike, from 1
        topic.channel.log(
            message, log_time=self.node.get_clock().now().nanoseconds, sink_id=client or None
        )
        self.forwarded += 1

    def _meet(self, name: str, publishers: list[Any]) -> None:
        """Open a channel, or another one where type or quality of service have changed."""
        kinds = sorted({offer.topic_type for offer in publishers})
        if len(kinds) > 1:
            self._refuse(name, f'it has the types {", ".join(kinds)}, expected one: remap others')
            return
        quality = adapted_quality((offer.qos_profile for offer in publishers), DEPTH)
        topic = self.topics.get(name)
        if topic is not None and (topic.kind, topic.quality) == (kinds[0], quality):
            return
        try:
            message_type(kinds[0])
            schema = message_schema(kinds[0])
        except (AttributeError, ImportError, FileNotFoundError, ValueError) as error:
            self._refuse(name, f'{kinds[0]} is missing ({error}): install its package')
            return
        clients = set() if topic is None else topic.clients
        if topic is not None and topic.kind == kinds[0]:  # the same channel, heard otherwise
            for subscription in topic.subscriptions.values():
                self.node.destroy_subscription(subscription)
            channel = topic.channel
        else:
            self._close(name)
            clients = set()
            channel = Channel(name, schema=schema, message_encoding=CDR, context=self.context)
        self.refused.pop(name, None)
        self.topics[name] = BridgedTopic(kinds[0], channel, quality)
        for client in clients:
            self.subscribe(name, client)

    def _close(self, name: str) -> None:
        topic = self.topics.pop(name, None)
        self.refused.pop(name, None)
        if topic is not None:
            for subscription in topic.subscriptions.values():
                self.node.destroy_subscription(subscription)
            topic.channel.close()

    def _refuse(self, name: str, reason: str) -> None:
        """Show a topic to no client; the reason is told once."""
        if self.refused.get(name) != reason:
            self._close(name)
            self.refused[name] = reason
            self.node.get_logger().warning(f'{name} is not shown: {reason}')
