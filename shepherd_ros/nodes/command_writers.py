"""Publishers of commands: several for one shepherd, or with a type that is not heard."""

from __future__ import annotations

from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.wire.topics import COMMANDS


class CommandWriters:
    """Finds publishers that should not be there, and logs each set of them once."""

    def __init__(self, node: ShepherdNode, kind: str) -> None:
        """Expect one publisher for each shepherd, of a type."""
        self.node, self.kind = node, kind
        self.rivals: dict[str, str] = {}  # topic -> its publishers, where there are several
        self.unheard: dict[str, str] = {}  # topic -> its other types, with all publishers

    def find(self, n_shepherds: int) -> None:
        """Look at the publishers of the commands of a team."""
        rivals, unheard = {}, {}
        for topic in (COMMANDS.format(h=h) for h in range(n_shepherds)):
            names = self.node.publishers_of(topic)
            infos = self.node.get_publishers_info_by_topic(topic)
            kinds = sorted({info.topic_type for info in infos} - {self.kind})
            if len(names) > 1:
                rivals[topic] = f'{len(names)} nodes ({", ".join(names)})'
            if kinds:
                unheard[topic] = f'{", ".join(kinds)} ({", ".join(names)})'
        for topic, text in rivals.items():
            if self.rivals.get(topic) != text:
                self.node.get_logger().warning(
                    f'{topic} is published by {text}, expected one: the last command counts; stop '
                    'one or remap its topic'
                )
        for topic, text in unheard.items():
            if self.unheard.get(topic) != text:
                self.node.get_logger().error(
                    f'{topic} is published as {text}, expected {self.kind}: such commands are '
                    'not heard; give flock_sim and its controllers the same value of stamped'
                )
        self.rivals, self.unheard = rivals, unheard
