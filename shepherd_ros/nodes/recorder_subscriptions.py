"""Subscriptions of a recorder: its topics, and their messages in order of arrival."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
import time
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription
from shepherd_ros.nodes.recorder_losses import Losses
from shepherd_ros.ros.node import message_type
from shepherd_ros.ros.polling import never, PolledGroup
from shepherd_ros.ros.reader_quality import adapted_quality, reader_quality
from shepherd_ros.rosbag2.qos import Qos
from shepherd_ros.wire.contract import known
from shepherd_ros.wire.schemas import installed_text, nested_text, wire_types
from shepherd_ros.wire.topics import contract

QUEUE_DEPTH = 10_000  # messages that may wait for the recorder, per topic
Row = tuple[str, bytes, dict[str, int]]  # topic, message, times and number


@dataclass
class RecordedTopic:
    """A subscription, and the publishers of its topic."""

    kind: str
    quality: QoSProfile
    subscription: Subscription
    offers: list[Any] = field(default_factory=list)  # publishers when they were last seen

    @property
    def latched(self) -> bool:
        """Return whether messages from before the subscription are received."""
        return bool(self.quality.durability == DurabilityPolicy.TRANSIENT_LOCAL)


class RecorderSubscriptions:
    """
    Subscribes to topics, and returns their messages in order of arrival.

    Topics of the contract are listened to before anybody publishes them, others as soon as
    look() finds them.
    """

    def __init__(
        self,
        node: Node,
        wanted: Callable[[str], bool],
        refuse: Callable[[str], None],
        wait: float = 0.0,
        verbose: bool = False,
    ) -> None:
        """
        Listen to the contract in the node's namespace; refuse(reason) hears what cannot be.

        With wait [s] messages are in the order in which they were sent, if none is later than so.
        verbose: each topic is named when it is found.
        """
        self.verbose, self.announced = verbose, 0  # topics, when tell() said how many
        self.node, self.wanted, self.refuse = node, wanted, refuse
        self.inputs: dict[str, RecordedTopic] = {}
        self.refused: dict[str, str] = {}
        self.losses = Losses(self._publishers)
        self.wait_ns, self.order = round(wait * 1e9), _sent if wait else _received
        self.group = PolledGroup()
        self.pending: list[Row] = []  # came after the last look at another topic began
        self.expect(node.get_namespace().rstrip('/'))
        self.look()

    # ---- messages ----

    def poll_messages(self, everything: bool = False) -> list[Row]:
        """Return the messages so far, in order; everything: also those that may be overtaken."""
        self.group.open = False
        now, rows = time.time_ns() - self.wait_ns, self.pending
        for name, recorded in self.inputs.items():
            handle, kind = recorded.subscription.handle, recorded.subscription.msg_type
            with handle:
                for _ in range(QUEUE_DEPTH):
                    message = handle.take_message(kind, True)
                    if message is None:
                        break
                    rows.append((name, *message))
        rows.sort(key=self.order)
        cut = len(rows) if everything else bisect_right(rows, now, key=self.order)
        self.pending = rows[cut:]
        return rows[:cut]

    # ---- topics ----

    def expect(self, namespace: str, n_shepherds: int = 0) -> None:
        """Subscribe to the topics of the contract in a namespace, with or without publishers."""
        topics, profiles = contract()
        for row in topics.values():
            for h in range(n_shepherds) if '{h}' in row.name else (0,):
                name = row.name.format(h=h)
                name = name if name.startswith('/') else f'{namespace}/{name}'
                if name not in self.inputs and self.wanted(name):
                    profile = profiles[row.profile]
                    reliable = profile.reliability == 'reliable'
                    latched = profile.durability == 'transient_local'
                    quality = reader_quality(reliable, latched, QUEUE_DEPTH)
                    try:
                        self._subscribe(name, row.type, quality)
                    except (AttributeError, ImportError):
                        continue  # look() refuses it once somebody publishes it

    def tell(self) -> None:
        """Say how many topics are recorded, if there are more than when it was last said."""
        offered = sum(bool(topic.offers) for topic in self.inputs.values())
        if offered > self.announced:
            self.announced = offered
            self.node.get_logger().info(f'recording {offered} topics')

    def look(self) -> None:
        """Subscribe to new topics, with the quality of service of their publishers."""
        for name, _ in self.node.get_topic_names_and_types():
            if self.wanted(name):
                offers = self.node.get_publishers_info_by_topic(name)
                recorded = self.inputs.get(name)
                if offers and (recorded is None or _ids(offers) != _ids(recorded.offers)):
                    self._on_publishers(name, offers)

    def _on_publishers(self, name: str, offers: list[Any]) -> None:
        """Listen to a topic that others publish than before."""
        recorded = self.inputs.get(name)
        kinds = sorted({offer.topic_type for offer in offers})
        if recorded is not None and recorded.offers:
            kinds = sorted({*kinds, recorded.kind})
        if len(kinds) > 1:
            self._refuse(name, f'it has the types {", ".join(kinds)}, expected one: remap others')
            return
        profiles = [offer.qos_profile for offer in offers]
        if recorded is not None and recorded.offers:
            profiles.append(recorded.quality)  # which still suits those from before
        quality = adapted_quality(profiles, QUEUE_DEPTH)
        if recorded is None or (recorded.kind, recorded.quality) != (kinds[0], quality):
            try:
                recorded = self._subscribe(name, kinds[0], quality)
            except (AttributeError, ImportError, FileNotFoundError, ValueError) as error:
                self._refuse(name, f'{kinds[0]} is missing ({error}): install it or --exclude')
                return
        if not recorded.offers:
            if self.verbose:
                self.node.get_logger().info(f'recording {name} ({recorded.kind})')
            entry = known(name)
            if entry is not None:
                self.expect(entry.namespace)
        recorded.offers = offers
        self.losses.topics[name].publishers |= _ids(offers)

    def _subscribe(self, name: str, kind: str, quality: QoSProfile) -> RecordedTopic:
        """Listen to a topic, instead of what was listened to before."""
        message = message_type(kind)
        if kind not in wire_types():
            nested_text(kind, installed_text)  # raises FileNotFoundError
        previous = self.inputs.get(name)
        if previous is not None:
            self.pending = self.poll_messages(everything=True)
            self.node.destroy_subscription(previous.subscription)
        subscription = self.node.create_subscription(
            message,
            name,
            never,
            quality,
            callback_group=self.group,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(
                message_lost=partial(self.losses.lost, name), use_default_callbacks=False
            ),
        )
        recorded = self.inputs[name] = RecordedTopic(kind, quality, subscription)
        if recorded.latched:
            self.losses.latched.add(name)
        return recorded

    def _refuse(self, name: str, reason: str) -> None:
        """Go on without a topic; the bag is not whole then."""
        if self.refused.get(name) != reason:
            self.refused[name] = reason
            self.refuse(f'{name} is not recorded: {reason}')

    def _publishers(self, name: str) -> set[bytes]:
        return _ids(self.node.get_publishers_info_by_topic(name))

    def described(self, name: str) -> dict[str, Any]:
        """Return a topic as it is announced to a bag."""
        recorded = self.inputs[name]
        offers = self.node.get_publishers_info_by_topic(name) or recorded.offers
        profiles = [offer.qos_profile for offer in offers]
        qos = tuple(_offered(profile) for profile in profiles)
        topic: dict[str, Any] = {'type_name': recorded.kind, 'qos': qos}
        if recorded.kind not in wire_types():
            schema = 'ros2msg', nested_text(recorded.kind, installed_text).encode()
            hash_text = str(offers[0].topic_type_hash) if offers else ''
            topic |= {'schema': schema, 'hash_text': hash_text}
        return topic


def _offered(profile: QoSProfile) -> Qos:
    """Return what a publisher offers, in rosbag2's words."""
    words = {
        name: getattr(profile, name).name.lower()
        for name in ('reliability', 'durability', 'liveliness')
    }
    durations = {
        name: divmod(getattr(profile, name).nanoseconds, 10**9)
        for name in ('deadline', 'lifespan', 'liveliness_lease_duration')
    }
    return Qos(**words, **durations)


def _received(row: Row) -> int:
    return row[2]['received_timestamp']


def _sent(row: Row) -> int:
    return row[2]['source_timestamp'] or row[2]['received_timestamp']


def _ids(offers: list[Any]) -> set[bytes]:
    return {bytes(offer.endpoint_gid) for offer in offers}
