"""Subscription to the topic episode."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from shepherd_ros.config import ConfigError
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.wire.topics import EPISODE

_Content = TypeVar('_Content')


def listen_to_episodes(
    node: ShepherdNode, read: Callable[[str], _Content], on_episode: Callable[[_Content], None]
) -> None:
    """Call on_episode(read(text)) for each new episode; log those that read() refuses."""
    current: list[_Content] = []

    def receive(text: str) -> None:
        try:
            episode = read(text)
        except ConfigError as error:
            node.get_logger().error(str(error))
            return
        if [episode] != current:  # flock_sim repeats the current one while a shepherd is silent
            current[:] = [episode]
            on_episode(episode)

    node.listen(EPISODE, receive)
