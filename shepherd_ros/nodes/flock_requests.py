"""
Requests to flock_sim: services ~/reset, ~/pause, ~/step and ~/move_goal, and topic goal_pose.

Only standard types: services with arguments are rcl_interfaces/srv/SetParameters, whose request is
a list of named, typed values and whose answer has a success and a reason for each.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import math
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import parameter_value_to_python
from shepherd_ros.config import ConfigError
from shepherd_ros.nodes.flock_pacing import Pacing
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.sim.limits import MAX_FLOAT32, MAX_SEED
from shepherd_ros.wire.decode import Vector
from shepherd_ros.wire.episode import Episode
from std_srvs.srv import SetBool


class FlockRequests:
    """Offers the services, hears goal_pose and calls what carries them out."""

    def __init__(
        self,
        node: ShepherdNode,
        pacing: Pacing,
        begin_episode: Callable[[int | None], Episode],
        move_goal: Callable[[float, float], None],
        resume: Callable[[], None],
    ) -> None:
        """Create the services and the subscription of a node."""
        self.node, self.pacing = node, pacing
        self.begin_episode, self.set_goal, self.resume = begin_episode, move_goal, resume
        for name, action in (
            ('reset', self.reset),
            ('step', self.step),
            ('move_goal', self.move_goal),
        ):
            node.create_service(SetParameters, f'~/{name}', self._named_arguments(name, action))
        node.create_service(SetBool, '~/pause', self.pause)
        node.listen('goal_pose', self.on_goal_pose)

    def _named_arguments(self, name: str, action: Any) -> Any:
        """Return a callback that reads named arguments and answers with one result for each."""

        def serve(request: Any, response: Any) -> Any:
            try:
                given = {p.name: parameter_value_to_python(p.value) for p in request.parameters}
                result = SetParametersResult(successful=True, reason=action(given))
            except ConfigError as error:
                result = SetParametersResult(successful=False, reason=f'{name}: {error}')
                self.node.get_logger().warning(result.reason)
            response.results = [result] * max(len(request.parameters), 1)
            return response

        return serve

    def reset(self, given: Mapping[str, Any]) -> str:
        """Start a new episode: argument seed (integer), else the next seed."""
        (seed,) = _take(given, {'seed': int}, required=False)
        if seed is not None and abs(seed) > MAX_SEED:
            raise ConfigError(f'seed is {seed}: expected at most {MAX_SEED}, also negative')
        episode = self.begin_episode(seed)
        return f'episode {episode.number}, seed {episode.seed}'

    def step(self, given: Mapping[str, Any]) -> str:
        """Make n steps (integer, 1 by default), then pause."""
        (n,) = _take(given, {'n': int}, required=False)
        if n is not None and n < 1:
            raise ConfigError(f'n is {n}: expected at least 1')
        self.pacing.pause(True, n or 1)
        self.resume()
        return f'{n or 1} steps, then paused'

    def move_goal(self, given: Mapping[str, Any]) -> str:
        """Move the goal to x, y [m] in the world frame."""
        x, y = _take(given, {'x': float, 'y': float}, required=True)
        if max(abs(x), abs(y)) > MAX_FLOAT32:
            raise ConfigError(f'goal is {x:g}, {y:g} m: expected numbers that float32 can hold')
        self.set_goal(x, y)
        return f'goal moves to {x:g}, {y:g} m'

    def on_goal_pose(self, pose: Vector) -> None:
        """Move the goal to a published pose, if its frame is the node's."""
        _, frame_id, x, y = pose
        expected, log = self.node.frame_id, self.node.get_logger()
        if frame_id != expected:
            log.warning(
                f'goal_pose is in frame {frame_id!r}, expected {expected!r}: ignored; set '
                f'the fixed frame of your tool to {expected!r}'
            )
        elif not all(abs(part) <= MAX_FLOAT32 for part in (x, y)):
            log.warning(f'goal_pose is {x}, {y}: expected finite numbers, ignored')
        else:
            self.set_goal(x, y)

    def pause(self, request: Any, response: Any) -> Any:
        """Pause on true, go on on false."""
        self.pacing.pause(request.data)
        self.resume()
        response.success, response.message = True, 'paused' if request.data else 'running'
        return response


def _take(given: Mapping[str, Any], known: Mapping[str, type], required: bool) -> list[Any]:
    """Return the arguments in the order known, None for one left out; ConfigError for others."""
    for name in given:
        if name not in known:
            raise ConfigError(f'argument {name!r}: expected {", ".join(known)}')
    values = []
    for name, kind in known.items():
        value = given.get(name)
        if kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if (value is None and required) or (value is not None and type(value) is not kind):
            raise ConfigError(f'argument {name} is {value!r}: expected {kind.__name__}')
        if isinstance(value, float) and not math.isfinite(value):
            raise ConfigError(f'argument {name} is {value}: expected a finite number')
        values.append(value)
    return values
