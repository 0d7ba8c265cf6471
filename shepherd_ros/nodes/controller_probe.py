"""A node that shows recorded states to a running controller and hears what it commands."""

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

RESEND_PERIOD = 0.25  # [s] after which an unanswered state is shown again, as flock_sim does
LATCHED_ACK_TIMEOUT = 5.0  # [s] that readers get to take what is latched, before states follow
ANSWER_TIMEOUT = 60.0  # [s] that a controller may take for an answer, its start included


class ControllerProbe(ShepherdNode):
    """Shows states one by one, each with the bytes that were recorded, and waits for answers."""

    def __init__(self, **kwargs: Any) -> None:
        """Create the node; topics come with the first episode."""
        super().__init__('controller_probe', **kwargs)
        self.outputs: dict[str, Output] = {}
        self.inputs: list[Any] = []
        self.hearing = make_executor('single')
        self.hearing.add_node(self)
        self.world_frame = ''
        self.goal: list[float] = []
        self.asked_ns = 0
        self.answers: dict[int, np.ndarray] = {}  # to the last state: (2,) m/s by shepherd

    def begin(self, episode: RecordedEpisode) -> None:
        """Announce a recorded episode."""
        for h in range(len(self.inputs), episode.n_shepherds):
            taker = partial(self.take, h)
            self.inputs.append(self.listen(COMMANDS, taker, h))
        self.world_frame, self.goal = episode.frame_id, []
        self.say(EPISODE, encode_text(episode.to_json()), latched=True)

    def ask(
        self,
        frame: Frame,
        raw: Mapping[str, bytes],
        shepherds: Collection[int],
        look: Callable[[], None],
    ) -> dict[int, np.ndarray]:
        """
        Return the commands (2,) m/s that answer a state, by shepherd.

        raw has the messages of the state by topic. It is shown again until all of the shepherds
        have answered, or for PATIENCE; look() is called each time.
        """
        goal = [0.0, 0.0] if frame.goal is None else frame.goal.tolist()
        if goal != self.goal:
            self.goal = goal
            self.say(GOAL, encode_goal(frame.stamp_ns, self.world_frame, *goal), latched=True)
        self.asked_ns = frame.stamp_ns
        self.answers = {}
        begun = self.wall()
        shown = begun - RESEND_PERIOD
        while not self.answers.keys() >= set(shepherds) and self.wall() - begun < ANSWER_TIMEOUT:
            if self.wall() - shown >= RESEND_PERIOD:
                shown = self.wall()
                self.say(CLOCK, encode_clock(frame.stamp_ns))
                for topic, content in raw.items():
                    self.say(topic, content)
                look()
            self.hearing.spin_once(timeout_sec=RESEND_PERIOD)
        return self.answers

    def say(self, topic: str, content: bytes, latched: bool = False) -> None:
        """Publish a message, such as shepherd_0/scan/goal; if latched, wait until it is read."""
        if topic not in self.outputs:
            ours = known(f'/{topic.lstrip("/")}')
            assert ours is not None, topic
            self.outputs[topic] = self.advertise(ours.topic.name, ours.shepherd)
        self.outputs[topic].publish(content)
        if latched:
            self.outputs[topic].wait_for_all_acked(Duration(seconds=LATCHED_ACK_TIMEOUT))

    def take(self, shepherd: int, command: Vector) -> None:
        """Keep a command if it answers the last state."""
        if command.stamp_ns == self.asked_ns:
            self.answers.setdefault(shepherd, command.xy)


@contextmanager
def open_controller_probe() -> Iterator[ControllerProbe]:
    """Yield a probe of a controller, in a ROS context of its own."""
    init_rclpy()
    node = ControllerProbe()
    try:
        yield node
    finally:
        node.hearing.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
