"""Subscriptions of mux to its sources, whose publishers may send Twist or TwistStamped."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import math

from rclpy.subscription import Subscription
from shepherd_ros.config import ConfigError
from shepherd_ros.nodes.command_mux import Velocity
from shepherd_ros.nodes.mux_parameters import MuxOptions
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.sim.limits import MAX_FLOAT32
from shepherd_ros.wire.decode import decode_motion, decode_motion_stamped, Motion
from shepherd_ros.wire.topics import command_type, COMMANDS

KINDS = {command_type(True): decode_motion_stamped, command_type(False): decode_motion}
WARNING_PERIOD = 5.0  # [s] between two warnings of one kind

OnCommand = Callable[[str, 'int | None', Velocity, 'int | None'], None]


class MuxSources:
    """
    Calls on_command(source, shepherd, velocity, stamp [ns]) for each command that is heard.

    shepherd is None for a topic that all share, and stamp for a command without one. A topic has
    one type in a process, so each subscription has that of its publishers.
    """

    def __init__(self, node: ShepherdNode, options: MuxOptions, on_command: OnCommand) -> None:
        """Begin without a shepherd."""
        self.node, self.options, self.on_command = node, options, on_command
        self.answering = {source.name for source in options.sources if source.answers}
        self.inputs: dict[tuple[str, int | None], tuple[str, Subscription]] = {}
        self.closing: dict[tuple[str, int | None], str] = {}  # next types of topics in use

    def begin(self, n_shepherds: int) -> None:
        """Subscribe to what commands the shepherds of an episode."""
        wanted = {
            (name, h if '{h}' in topic else None)
            for name, topic in self.options.topics.items()
            for h in range(n_shepherds)
        }
        for key in [key for key in self.inputs if key not in wanted]:
            self.node.destroy_subscription(self.inputs.pop(key)[1])
        self.closing = {key: kind for key, kind in self.closing.items() if key in wanted}
        for key in sorted(wanted - self.inputs.keys() - self.closing.keys(), key=str):
            self._subscribe(key, self._offered(key)[0])

    def topic(self, key: tuple[str, int | None]) -> str:
        """Return the topic of a source for a shepherd."""
        return self.options.topics[key[0]].replace('{h}', str(key[1]))

    def match(self) -> None:
        """Take the type of those who publish, where that is another one now."""
        for key, kind in list(self.closing.items()):
            self._subscribe(key, kind)
        for key, (kind, subscription) in list(self.inputs.items()):
            offered = self._offered(key)
            if kind not in offered:  # DDS frees the topic when the executor has let go of it
                self.node.destroy_subscription(subscription)
                del self.inputs[key]
                self.closing[key] = offered[0]
            elif len(offered) > 1:
                self.node.get_logger().warning(
                    f'{self.topic(key)} has the types {", ".join(offered)}: expected one, {kind} '
                    'is heard; remap one of its publishers',
                    throttle_duration_sec=WARNING_PERIOD,
                )

    def _offered(self, key: tuple[str, int | None]) -> list[str]:
        """Return the types in which others publish a source, that of the commands if none do."""
        infos = self.node.get_publishers_info_by_topic(self.topic(key))
        found = {info.topic_type for info in infos}
        return [kind for kind in KINDS if kind in found] or [
            self.inputs[key][0] if key in self.inputs else command_type(self.options.stamped)
        ]

    def _subscribe(self, key: tuple[str, int | None], kind: str) -> None:
        receiver, topic = partial(self._receive, *key), self.topic(key)
        self.closing[key] = kind
        try:
            subscription = self.node.listen(
                COMMANDS, receiver, kind=kind, decode=KINDS[kind], name=topic
            )
        except ConfigError as error:
            self.node.get_logger().warning(
                f'{error}; tried again',
                throttle_duration_sec=WARNING_PERIOD,
            )
        else:
            del self.closing[key]
            self.inputs[key] = kind, subscription

    def _receive(self, name: str, shepherd: int | None, motion: Motion) -> None:
        velocity = motion.x, motion.y, motion.turn
        if name in self.answering:
            stamp_ns, expected = motion.stamp_ns, self.node.frame_id
            if stamp_ns is not None and motion.frame_id != expected:
                self._refuse(
                    name, shepherd, f'is in frame {motion.frame_id!r}, expected {expected!r}'
                )
                return
            self.on_command(name, shepherd, velocity, stamp_ns)
        elif all(math.isfinite(part) and abs(part) <= MAX_FLOAT32 for part in velocity):
            self.on_command(name, shepherd, velocity, None)
        else:
            self._refuse(name, shepherd, f'is {velocity}, expected finite numbers')

    def _refuse(self, name: str, shepherd: int | None, reason: str) -> None:
        self.node.get_logger().warning(
            f'{self.topic((name, shepherd))}: a command {reason}: ignored',
            throttle_duration_sec=WARNING_PERIOD,
        )
