"""Types and quality of service of recorded topics for playback."""

from __future__ import annotations

from typing import Any

from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.validate_full_topic_name import validate_full_topic_name
from shepherd_ros.config import ConfigError
from shepherd_ros.ros.node import message_type
from shepherd_ros.rosbag2.bag import Bag
from shepherd_ros.rosbag2.metadata import TopicInfo
from shepherd_ros.rosbag2.qos import agreed_policy, duration_ns, history, Qos
from shepherd_ros.wire.contract import installed_hash, text_hash


def playable_type(bag: Bag, topic: TopicInfo) -> Any:
    """Return the message type of a recorded topic; ConfigError if it cannot be played."""
    fix = 'choose others with --topics'
    if topic.serialization != 'cdr':
        raise ConfigError(
            f'{bag.path}: {topic.name} is in {topic.serialization!r}, expected cdr; {fix}'
        )
    try:
        validate_full_topic_name('/' + topic.name.removeprefix('/'))
        message_class = message_type(topic.type)
    except InvalidTopicNameException as error:
        raise ConfigError(
            f'{bag.path}: {topic.name!r} is no name of a topic in ROS 2; {fix}'
        ) from error
    except (AttributeError, ImportError, ValueError) as error:
        raise ConfigError(
            f'{bag.path}: {topic.name} has the type {topic.type!r}, which is not '
            f'installed; install its package or {fix}'
        ) from error
    installed = installed_hash(topic.type)
    for name, encoding, text in bag.definitions[topic.name]:
        parsed = text_hash(name, text.decode(errors='replace')) if encoding == 'ros2msg' else ''
        recorded = parsed or topic.type_hash
        if name != topic.type or (installed and recorded and installed != recorded):
            raise ConfigError(
                f'{bag.path}: {topic.name} was recorded with another {name!r} than the '
                f'{topic.type!r} that is installed; install that package or {fix}'
            )
    return message_class


def recorded_quality(qos: tuple[Qos, ...]) -> QoSProfile:
    """Return the recorded quality of service, rosbag2's default where publishers disagreed."""
    best_effort = bool(qos) and all(q.reliability == 'best_effort' for q in qos)
    latched = history(qos)
    durations = {
        name: Duration(nanoseconds=duration_ns(agreed_policy(qos, name)))
        for name in ('deadline', 'lifespan', 'liveliness_lease_duration')
    }
    by_topic = agreed_policy(qos, 'liveliness') == 'manual_by_topic'
    return QoSProfile(
        depth=latched or max([q.depth for q in qos] or [0]) or 100,
        reliability=(ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE),
        durability=(DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE),
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC if by_topic else LivelinessPolicy.AUTOMATIC,
        **durations,
    )
