"""Publishers of flock_sim."""

from __future__ import annotations

from dataclasses import replace

from rclpy.duration import Duration
from shepherd_ros.ros.markers import world_markers
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.ros.transforms import TransformOutput
from shepherd_ros.sim.rollout import Moment
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import unit
from shepherd_ros.wire.encode import (
    encode_clock,
    encode_goal,
    encode_goal_poses,
    encode_poses,
    encode_text,
)
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.topics import (
    CLOCK,
    EPISODE,
    GOAL,
    GOAL_POSES,
    SHEEP_POSES,
    SHEPHERD_POSES,
)
import torch

MARKER_PERIOD = 0.05  # [s] wall time between two pictures
POSES = (SHEEP_POSES, SHEPHERD_POSES)
TOPICS = (EPISODE, GOAL, CLOCK, *POSES, 'markers')


class WorldOutput:
    """The publishers of clock, poses, goal, episode, markers and frames."""

    def __init__(self, node: ShepherdNode) -> None:
        """Create the publishers."""
        self.node = node
        clock = node.option(
            'publish_clock', True, 'publish /clock; false where another world of this graph does'
        )
        self.outputs = {name: node.advertise(name) for name in TOPICS if name != CLOCK or clock}
        self.transforms = TransformOutput(node)
        self.last_markers = 0.0
        self.goal_moves = False

    def expect_goal(self, moves: bool) -> None:
        """Publish the goal with each state of the next episode, or only once."""
        self.goal_moves = moves
        if moves and GOAL_POSES not in self.outputs:
            self.outputs[GOAL_POSES] = self.node.advertise(GOAL_POSES)

    def episode(self, ns: int, episode: Episode, state: WorldState, seconds: float = 0.2) -> None:
        """Publish the latched topics, and wait until all readers have them, at most `seconds`."""
        self.expect_goal(episode.goal_moves)
        self.outputs[EPISODE].publish(encode_text(episode.to_json()))
        self.goal(ns, state)
        self.wait(EPISODE, GOAL, seconds=seconds)

    def end(self, ns: int, episode: Episode, moment: Moment) -> Episode:
        """Publish how an episode has ended, if it has and its task has several ends; return it."""
        if moment.config.world.task.ends and moment.ended:
            episode = replace(episode, end='terminated' if moment.terminated else 'truncated')
            self.episode(ns, episode, moment.state, seconds=0.0)
        return episode

    def goal(self, ns: int, state: WorldState) -> None:
        """Publish the position of the goal."""
        x, y = state.goal.tolist()
        self.outputs[GOAL].publish(encode_goal(ns, self.node.frame_id, x, y))

    def state(self, ns: int, state: WorldState, before: WorldState) -> None:
        """Publish clock and poses; the shepherds' headings point from the state before."""
        frame, heading = self.node.frame_id, unit(state.shepherds - before.shepherds)
        if CLOCK in self.outputs:
            self.outputs[CLOCK].publish(encode_clock(ns))
        if self.goal_moves:
            goal, destination = state.goal.numpy(), state.destination.numpy()
            self.outputs[GOAL_POSES].publish(encode_goal_poses(ns, frame, goal, destination))
            if not torch.equal(state.goal, before.goal):
                self.goal(ns, state)
        self.outputs[SHEPHERD_POSES].publish(
            encode_poses(ns, frame, state.shepherds.numpy(), heading.numpy())
        )
        self.outputs[SHEEP_POSES].publish(
            encode_poses(ns, frame, state.sheep.numpy(), state.heading.numpy())
        )
        self.transforms.publish(ns, state.shepherds)
        now = self.node.wall()
        if now - self.last_markers > MARKER_PERIOD:
            if self.outputs['markers'].get_subscription_count():
                self.outputs['markers'].publish(world_markers(ns, frame, state))
            self.last_markers = now

    def readers(self) -> int:
        """Return the number of subscriptions to the poses that DDS has discovered."""
        return sum(self.outputs[topic].get_subscription_count() for topic in POSES)

    def wait(self, *topics: str, seconds: float) -> None:
        """Wait until every reader has acknowledged all, at most `seconds` for each topic."""
        for topic in topics:
            self.outputs[topic].wait_for_all_acked(Duration(seconds=seconds))
