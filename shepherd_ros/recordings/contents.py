"""Contents of messages in bags."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from shepherd_ros.config import ConfigError
from shepherd_ros.rosbag2.bag import Bag, BagMessage
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.wire.contract import known
from shepherd_ros.wire.decode import CdrError, DECODERS
from shepherd_ros.wire.drivers import Drivers
from shepherd_ros.wire.topics import DRIVERS


def decode_message(bag: Bag, message: BagMessage, kinds: Collection[str]) -> Any:
    """Return a message of one of the expected types; raises BagError."""
    place = f'{message.topic} at log time {message.log_ns} ns'
    if message.type not in kinds:
        expected = ' or '.join(kinds)
        raise BagError(
            bag.path,
            f'{place} has type {message.type[:80]!r}, expected {expected}',
            'record with the topics of msg_schemas/topics.yaml',
        )
    try:
        content, entry = DECODERS[message.type](message.data), known(message.topic)
        return Drivers.from_json(content) if entry and entry.topic.name == DRIVERS else content
    except ConfigError as error:
        raise BagError(bag.path, f'{place}: {error}') from error
    except CdrError as error:
        raise BagError(bag.path, f'{place} is no {message.type}: {error}') from error
