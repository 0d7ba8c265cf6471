"""A node that publishes recorded states to a running controller and collects its commands."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
import rclpy
from rclpy.duration import Duration
from shepherd_ros.recordings.episodes import Frame, RecordedEpisode
from shepherd_ros.ros.intra_process import Output
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.ros.runtime import init_rclpy, make_executor
from shepherd_ros.wire.contract import known
from shepherd_ros.wire.decode import Vector
from shepherd_ros.wire.encode import encode_clock, encode_goal, encode_text
from shepherd_ros.wire.topics import CLOCK, COMMANDS, EPISODE, GOAL

RESEND_PERIOD = 0.25  # [s] after which a state without response is published again
LATCHED_ACK_TIMEOUT = 5.0  # [s] for readers to acknowledge latched messages before states follow
ANSWER_TIMEOUT = 60.0  # [s] for the first command of a controller, its start included
TEAM_TIMEOUT = 10.0  # [s] between the commands for two shepherds


class ControllerProbe(ShepherdNode):
    """Publishes states one by one, each as the recorded bytes, and waits for commands."""

    def __init__(self, **kwargs: Any) -> None:
        """Create the node; begin() subscribes."""
        super().__init__('controller_probe', **kwargs)
        self.outputs: dict[str, Output] = {}
        self.inputs: list[Any] = []
        self.probe_executor = make_executor('single')
        self.probe_executor.add_node(self)
        self.world_frame = ''
        self.goal: list[float] = []
        self.stamp_ns = 0
        self.commands: dict[int, np.ndarray] = {}  # to the last state: (2,) m/s by shepherd

    def begin(self, episode: RecordedEpisode) -> None:
        """Publish the description of a recorded episode, and subscribe to its commands."""
        for h in range(len(self.inputs), episode.n_shepherds):
            callback = partial(self.on_command, h)
            self.inputs.append(self.listen(COMMANDS, callback, h))
        self.world_frame, self.goal = episode.frame_id, []
        self.publish(EPISODE, encode_text(episode.to_json()), latched=True)

    def request_commands(
        self,
        frame: Frame,
        raw: Mapping[str, bytes],
        shepherds: Collection[int],
        on_resend: Callable[[], None],
    ) -> dict[int, np.ndarray]:
        """
        Return the commands (2,) m/s for a state, by shepherd; without those that did not come.

        raw has the messages of the state by topic. It is published again until all shepherds have
        answered or the next is late; on_resend() is called each time.
        """
        goal = [0.0, 0.0] if frame.goal is None else frame.goal.tolist()
        if goal != self.goal:
            self.goal = goal
            self.publish(GOAL, encode_goal(frame.stamp_ns, self.world_frame, *goal), latched=True)
        self.stamp_ns = frame.stamp_ns
        self.commands = {}
        deadline = self.wall() + ANSWER_TIMEOUT
        last_sent = self.wall() - RESEND_PERIOD
        while not self.commands.keys() >= set(shepherds) and self.wall() < deadline:
            if self.wall() - last_sent >= RESEND_PERIOD:
                last_sent = self.wall()
                self.publish(CLOCK, encode_clock(frame.stamp_ns))
                for topic, content in raw.items():
                    self.publish(topic, content)
                on_resend()
            count = len(self.commands)
            self.probe_executor.spin_once(timeout_sec=RESEND_PERIOD)
            if len(self.commands) > count:
                deadline = self.wall() + TEAM_TIMEOUT
        return self.commands

    def publish(self, topic: str, content: bytes, latched: bool = False) -> None:
        """Publish a message on a topic; if latched, wait until it is acknowledged."""
        if topic not in self.outputs:
            entry = known(f'/{topic.lstrip("/")}')
            assert entry is not None, topic
            self.outputs[topic] = self.advertise(entry.topic.name, entry.shepherd)
        self.outputs[topic].publish(content)
        if latched:
            self.outputs[topic].wait_for_all_acked(Duration(seconds=LATCHED_ACK_TIMEOUT))

    def on_command(self, shepherd: int, command: Vector) -> None:
        """Store a command if its stamp is that of the last state."""
        if command.stamp_ns == self.stamp_ns:
            self.commands.setdefault(shepherd, command.xy)


@contextmanager
def open_controller_probe() -> Iterator[ControllerProbe]:
    """Yield a probe of a controller, in a ROS context of its own."""
    init_rclpy()
    node = ControllerProbe()
    try:
        yield node
    finally:
        node.probe_executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
