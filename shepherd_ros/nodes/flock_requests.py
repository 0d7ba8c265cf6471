"""Requests to flock_sim: services ~/reset, ~/pause and ~/step, and topic goal_pose."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from shepherd_ros.nodes.flock_pacing import Pacing
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.sim.limits import MAX_FLOAT32
from shepherd_ros.wire.decode import Vector
from shepherd_ros.wire.episode import Episode
from std_srvs.srv import SetBool, Trigger


class FlockRequests:
    """Serves reset, pause and step, and subscribes to goal_pose."""

    def __init__(
        self,
        node: ShepherdNode,
        pacing: Pacing,
        begin_episode: Callable[[], Episode],
        move_goal: Callable[[float, float], None],
        resume: Callable[[], None],
    ) -> None:
        """Create the services and the subscription of a node."""
        self.node, self.pacing = node, pacing
        self.begin_episode, self.move_goal, self.resume = begin_episode, move_goal, resume
        node.create_service(Trigger, '~/reset', self.reset)
        node.create_service(Trigger, '~/step', self.step)
        node.create_service(SetBool, '~/pause', self.pause)
        node.listen('goal_pose', self.on_goal_pose)

    def reset(self, request: Any, response: Any) -> Any:
        """Start a new episode, with the seed of parameter seed if it was set, or the next."""
        episode = self.begin_episode()
        response.success = True
        response.message = f'episode {episode.number}, seed {episode.seed}'
        return response

    def step(self, request: Any, response: Any) -> Any:
        """Make step_size steps, then pause."""
        n = self.node.get_parameter('step_size').value
        self.pacing.pause(True, n)
        self.resume()
        response.success, response.message = True, f'{n} steps, then paused'
        return response

    def pause(self, request: Any, response: Any) -> Any:
        """Pause on true, go on on false."""
        self.pacing.pause(request.data)
        self.resume()
        response.success, response.message = True, 'paused' if request.data else 'running'
        return response

    def on_goal_pose(self, pose: Vector) -> None:
        """Move the goal to a published pose, if its frame is the node's."""
        frame_id, (x, y) = pose.frame_id, pose.xy.tolist()
        expected, log = self.node.frame_id, self.node.get_logger()
        if frame_id != expected:
            log.warning(
                f'goal_pose is in frame {frame_id!r}, expected {expected!r}: ignored; set '
                f'the fixed frame of your tool to {expected!r}'
            )
        elif not all(abs(part) <= MAX_FLOAT32 for part in (x, y)):
            log.warning(f'goal_pose is {x}, {y}: expected finite numbers, ignored')
        else:
            self.move_goal(x, y)
