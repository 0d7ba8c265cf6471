"""A node that controls a running world from a command line."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import os
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.srv import GetParameters, SetParameters
import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from shepherd_ros.config import ConfigError, unknown_name
from shepherd_ros.nodes.command_mux import AUTO
from shepherd_ros.ros.node import message_type, quality
from shepherd_ros.ros.runtime import init_rclpy
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.topics import EPISODE, row_of, SHEPHERD
from std_srvs.srv import SetBool, Trigger

_WORLD = 'flock_sim'
DISCOVERY_TIMEOUT = 5.0  # [s] in which a world is found, or is not there
SETTLE_TIME = 0.5  # [s] after which no more services of a node are expected
REPORT_TIMEOUT = 1.5  # [s] after which no more nodes and reports are expected
LEVELS = {
    DiagnosticStatus.OK: 'OK',
    DiagnosticStatus.WARN: 'WARN',
    DiagnosticStatus.ERROR: 'ERROR',
}


class WorldClient(Node):
    """Calls the services of flock_sim in a namespace; ConfigError if there is none."""

    def reset(self, seed: int | None) -> str:
        """Begin the next episode, with a seed if one is given; return its description."""
        if seed is not None:
            self._set('seed', seed)
        return self._call('reset', Trigger, Trigger.Request()).message

    def step(self, n: int) -> str:
        """Make n steps, then pause; return a message."""
        self._set('step_size', n)
        return self._call('step', Trigger, Trigger.Request()).message

    def drive(self, source: str, shepherd: int | None) -> str:
        """Select a source of mux for one shepherd or all; return its message."""
        room = 'mux/select' if shepherd is None else f'{SHEPHERD.format(h=shepherd)}/mux'
        return self._ask_mux(f'{room}/{source}', Trigger, Trigger.Request())

    def lock(self, locked: bool, shepherd: int | None) -> str:
        """Lock or unlock one shepherd or all; return the message of mux."""
        room = 'mux' if shepherd is None else f'{SHEPHERD.format(h=shepherd)}/mux'
        return self._ask_mux(f'{room}/lock', SetBool, SetBool.Request(data=locked))

    def _ask_mux(self, name: str, kind: Any, request: Any) -> str:
        """Return the response of a service of mux; ConfigError names the existing ones."""
        place, _, last = f'{self.get_namespace().rstrip("/")}/{name}'.rpartition('/')
        limit, others = time.monotonic() + DISCOVERY_TIMEOUT, list[str]()
        while not self.count_services(name) and time.monotonic() < limit:
            time.sleep(0.02)
            names = [n for n, _ in self.get_service_names_and_types() if self.count_services(n)]
            known = [n.removeprefix(f'{place}/') for n in names if n.startswith(f'{place}/')]
            if AUTO in known and known == others:
                limit = min(limit, time.monotonic() + SETTLE_TIME)
            others = known
        response = self._ask(name, kind, request) if self.count_services(name) else None
        if response is None and AUTO in others:
            raise unknown_name(f'source in {place}', last, sorted(others))
        if response is None:
            raise ConfigError(
                f'no {place}/{last} was found within {DISCOVERY_TIMEOUT:g} s: expected a mux that '
                'runs; start one, such as with mux:=true of simulate.launch.py, and check the '
                'shepherd, --namespace and ROS_DOMAIN_ID'
            )
        if not response.success:
            raise ConfigError(response.message)
        return str(response.message)

    def pause(self, paused: bool) -> str:
        """Pause, or go on; return the state."""
        return self._call('pause', SetBool, SetBool.Request(data=paused)).message

    def move_goal(self, x: float, y: float) -> str:
        """Move the goal to x, y [m]; return a message."""
        request = GetParameters.Request(names=['frame_id'])
        (frame,) = self._call('get_parameters', GetParameters, request).values
        pose = PoseStamped()
        pose.header.frame_id = parameter_value_to_python(frame)
        pose.pose.position.x, pose.pose.position.y = x, y
        pose.pose.orientation.w = 1.0
        publisher = self.create_publisher(PoseStamped, 'goal_pose', quality('goal_pose'))
        limit = time.monotonic() + DISCOVERY_TIMEOUT
        while not publisher.get_subscription_count():
            if time.monotonic() > limit:
                raise self._not_found()
            time.sleep(0.02)
        publisher.publish(pose)
        publisher.wait_for_all_acked(Duration(seconds=DISCOVERY_TIMEOUT))
        return f'goal moves to {x:g}, {y:g} m'

    def status(self) -> list[str]:
        """Return a line for the episode and one for each part of every node that reports."""
        lines: dict[str, str] = {}

        def on_report(report: DiagnosticArray) -> None:
            for s in report.status:
                lines[s.name] = f'{LEVELS.get(s.level, "?"):5}  {s.name}: {s.message}'

        def on_episode(message: Any) -> None:
            e = Episode.from_json(message.data)
            lines[EPISODE] = (
                f'episode {e.number}, seed {e.seed}: {e.n_sheep} sheep, {e.n_shepherds} '
                f'shepherds, {e.mode}'
            )

        def silent() -> list[str]:
            reported = {name.partition(': ')[0] for name in lines}
            return [n for n in self._reporters() if n not in reported]

        kind = message_type(row_of(EPISODE).type)
        self.create_subscription(DiagnosticArray, '/diagnostics', on_report, 100)
        self.create_subscription(kind, EPISODE, on_episode, quality(EPISODE, subscribe=True))
        self._settle(lambda: {*lines, *self._reporters()}, lambda: bool(lines) and not silent())
        if not lines:
            raise self._not_found()
        for name in silent():
            lines[name] = f'STALE  {name}: no message of this name within {DISCOVERY_TIMEOUT:g} s'
        return [lines[name] for name in sorted(lines, key=lambda name: (name != EPISODE, name))]

    def _reporters(self) -> set[str]:
        """Return the nodes that publish /diagnostics, and the episode if it has a publisher."""
        ends = self.get_publishers_info_by_topic('/diagnostics')
        names = {f'{end.node_namespace}/{end.node_name}'.lstrip('/') for end in ends}
        return names | ({EPISODE} if self.count_publishers(EPISODE) else set())

    def nodes(self) -> list[str]:
        """Return the full names of the nodes that run but for hidden ones; ConfigError if none."""

        def visible() -> set[str]:
            names = self.get_node_names_and_namespaces()
            full = {f'{space.rstrip("/")}/{name}' for name, space in names}
            return {name for name in full - {self.get_fully_qualified_name()} if '/_' not in name}

        known = self._settle(visible, lambda: bool(visible()))
        if not known:
            raise ConfigError(
                f'no node was found within {DISCOVERY_TIMEOUT:g} s: expected one that runs; start '
                f'it, or check {_domain()}'
            )
        return sorted(known)

    def _settle(self, known: Callable[[], set[str]], complete: Callable[[], bool]) -> set[str]:
        """
        Return known() once it has not changed for a while, spinning.

        That is REPORT_TIMEOUT where it is complete(), else DISCOVERY_TIMEOUT.
        """
        seen, changed = known(), time.monotonic()
        while time.monotonic() < changed + (REPORT_TIMEOUT if complete() else DISCOVERY_TIMEOUT):
            rclpy.spin_once(self, timeout_sec=0.1)
            if (now := known()) != seen:
                seen, changed = now, time.monotonic()
        return seen

    def _set(self, name: str, value: Any) -> None:
        """Set a parameter of the world; ConfigError with its reason if it refuses."""
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        (result,) = self._call('set_parameters', SetParameters, request).results
        if not result.successful:
            raise ConfigError(result.reason)

    def _call(self, name: str, kind: Any, request: Any) -> Any:
        """Return what a service of the world answers."""
        response = self._ask(f'{_WORLD}/{name}', kind, request)
        if response is None:
            raise self._not_found()
        return response

    def _ask(self, name: str, kind: Any, request: Any) -> Any:
        """Return what a service answers, None where there is none."""
        client = self.create_client(kind, name)
        if not client.wait_for_service(timeout_sec=DISCOVERY_TIMEOUT):
            return None
        future = client.call_async(request)
        rclpy.spin_until_future_complete(self, future, timeout_sec=DISCOVERY_TIMEOUT)
        if not future.done():
            raise ConfigError(f'{client.srv_name} has not answered within {DISCOVERY_TIMEOUT:g} s')
        return future.result()

    def _not_found(self) -> ConfigError:
        """Return the error for a missing world."""
        name = f'{self.get_namespace().rstrip("/")}/{_WORLD}'
        return ConfigError(
            f'no {name} was found within {DISCOVERY_TIMEOUT:g} s: expected one that runs; start '
            f'it, or check --namespace and {_domain()}'
        )


def _domain() -> str:
    """Return the variable that says which nodes can be found, with its value."""
    return f'ROS_DOMAIN_ID, which is {os.environ.get("ROS_DOMAIN_ID", "0")}'


@contextmanager
def world_client(namespace: str) -> Iterator[WorldClient]:
    """Yield a client of the world in a namespace."""
    init_rclpy()
    client = WorldClient('shepherd', namespace=namespace, start_parameter_services=False)
    try:
        yield client
    finally:
        client.destroy_node()
        rclpy.try_shutdown()
