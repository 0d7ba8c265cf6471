"""Subscription to the topic episode."""

from __future__ import annotations

from collections.abc import Callable

from shepherd_ros.config import ConfigError
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.topics import EPISODE


def listen_to_episodes(
    node: ShepherdNode, on_episode: Callable[[Episode, WorldConfig], None]
) -> None:
    """Call on_episode(episode, its world) for each new episode; log those that are refused."""
    current: list[Episode] = []

    def receive(text: str) -> None:
        try:
            episode = Episode.from_json(text)
            world = WorldConfig.from_dict(episode.world)
        except ConfigError as error:
            node.get_logger().error(str(error))
            return
        if [episode] != current:  # flock_sim repeats the current one while a shepherd is silent
            current[:] = [episode]
            on_episode(episode, world)

    node.listen(EPISODE, receive)
