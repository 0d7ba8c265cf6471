"""Requests of the console to flock_sim: pause, step, reset, pace, settings and goal."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import math
from typing import Any

from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python
from shepherd_ros.config import ConfigError, unknown_name
from shepherd_ros.console.commands import ConsoleCommand
from shepherd_ros.console.desk import Answer
from shepherd_ros.console.page_server import PageServer
from shepherd_ros.nodes.console_calls import Done, ServiceCalls
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.wire.encode import encode_goal
from std_srvs.srv import SetBool, Trigger

WORLD_NODE = 'flock_sim'
REPORT_DELAY = 2.5  # [s] in which the report of a node may be of before
SETTINGS = ('n_sheep', 'n_shepherds', 'flock', 'preset', 'goal_radius', 'episode_steps')
_SERVICES = {
    'pause': SetBool,
    'step': Trigger,
    'reset': Trigger,
    'set_parameters': SetParameters,
    'get_parameters': GetParameters,
    'describe_parameters': DescribeParameters,
}


class WorldRequests:
    """
    Carries out commands on flock_sim of the namespace, in the server's loop.

    tell(kind, **content) hears what it is set to, as message `world`.
    """

    def __init__(self, node: ShepherdNode, tell: Callable[..., None]) -> None:
        """Create the clients and the publisher of the goal."""
        self.node, self.tell = node, tell
        self.calls = ServiceCalls(
            node, {f'{WORLD_NODE}/{name}': kind for name, kind in _SERVICES.items()}
        )
        self.goal_output = node.advertise('goal_pose')
        self.server: PageServer | None = None  # once it runs
        self.present = False
        self.current = self.asking = False  # whether settings are those of the world, or to come
        self.refreshes = 0  # what an earlier one asked for is not heard
        self.paused: bool | None = None
        self.changed = -REPORT_DELAY  # when a page paused it or let it go on [s]
        self.rate = 0.0
        self.settings: dict[str, dict[str, Any]] = {}
        self.commands: dict[str, Callable[..., None]] = {
            'pause': partial(self._pause, True),
            'resume': partial(self._pause, False),
            'step': self._step,
            'reset': self._reset,
            'rate': self._rate,
            'settings': self._settings,
            'goal': self._goal,
        }

    def perform(self, command: ConsoleCommand, answer: Answer) -> None:
        """Carry out a command; raises ConfigError for values that cannot be."""
        self.commands[command.name](answer, **command.values)

    # ---- what it is set to ----

    def look(self, reports: list[dict[str, Any]]) -> None:
        """Find out whether the world is there, and from its report whether it is paused."""
        present = self.calls.ready(f'{WORLD_NODE}/pause')
        space = self.node.get_namespace().strip('/')
        name = f'{space}/{WORLD_NODE}: episode'.lstrip('/')
        messages = [report['message'] for report in reports if report['name'] == name]
        if self.node.wall() - self.changed > REPORT_DELAY:
            self.paused = messages[0] == 'paused' if present and messages else None
        if not present:
            self.current = False
        elif not (self.current or self.asking):
            self.refresh()
        self.present = present
        self.say()

    def say(self) -> None:
        """Tell pages what the world is set to."""
        self.tell(
            'world', present=self.present, paused=self.paused, rate=self.rate,
            settings=self.settings if self.present else {},
        )  # fmt: skip

    def refresh(self) -> None:
        """Ask the world for its parameters and tell them; look() asks again without an answer."""
        names = [*SETTINGS, 'rate']
        self.current, self.asking = False, True
        self.refreshes += 1
        number = self.refreshes

        def described(answer: Any, reason: str) -> None:
            if number != self.refreshes:
                return
            self.asking = answer is not None and len(answer.descriptors) == len(names)
            if self.asking:
                self._call(
                    'get_parameters',
                    GetParameters.Request(names=names),
                    partial(with_values, answer.descriptors),
                )

        def with_values(descriptors: list[Any], answer: Any, reason: str) -> None:
            if number != self.refreshes:
                return
            self.asking = False
            self.current = answer is not None and len(answer.values) == len(names)
            if self.current:
                values = [parameter_value_to_python(value) for value in answer.values]
                about = {
                    name: _about(descriptor, value)
                    for name, descriptor, value in zip(names, descriptors, values, strict=True)
                    if value is not None
                }
                self.rate = about.pop('rate', {}).get('value', 0.0)
                self.settings = about
                self.say()

        self._call('describe_parameters', DescribeParameters.Request(names=names), described)

    # ---- commands ----

    def _call(self, name: str, request: Any, done: Done) -> None:
        assert self.server is not None
        self.calls.call(self.server, f'{WORLD_NODE}/{name}', request, done)

    def _set(self, values: dict[str, Any], done: Callable[[str], None]) -> None:
        """Set parameters; done(why) hears '' if all were taken."""
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        request = SetParameters.Request(parameters=[p.to_parameter_msg() for p in parameters])

        def answered(response: Any, reason: str) -> None:
            results = [] if response is None else response.results
            reasons = [result.reason for result in results if not result.successful]
            done(reason or '; '.join(reasons))

        self._call('set_parameters', request, answered)

    def _ask(self, answer: Answer, name: str, request: Any, paused: bool | None = None) -> None:
        """Call a service and answer what it says; paused is the state it leaves."""

        def answered(response: Any, reason: str) -> None:
            ok = response is not None and response.success
            if ok and paused is not None:
                self.paused, self.changed = paused, self.node.wall()
                self.say()
            answer(ok, reason or response.message)

        self._call(name, request, answered)

    def _pause(self, paused: bool, answer: Answer) -> None:
        self._ask(answer, 'pause', SetBool.Request(data=paused), paused)

    def _step(self, answer: Answer, steps: int) -> None:
        self._after({'step_size': steps}, answer, 'step', paused=True)

    def _reset(self, answer: Answer, seed: int | None = None) -> None:
        if seed is None:
            self._ask(answer, 'reset', Trigger.Request())
        else:
            self._after({'seed': seed}, answer, 'reset')

    def _after(
        self, values: dict[str, Any], answer: Answer, name: str, paused: bool | None = None
    ) -> None:
        """Set parameters, then call a service."""

        def done(reason: str) -> None:
            if reason:
                answer(False, reason)
            else:
                self._ask(answer, name, Trigger.Request(), paused)

        self._set(values, done)

    def _rate(self, answer: Answer, rate: float) -> None:
        text = f'{rate:g} steps per second' if rate else 'the pace of the world'
        self._answer_set({'rate': rate}, answer, text)

    def _settings(self, answer: Answer, values: dict[str, Any]) -> None:
        if not values:
            raise ConfigError(f'values is {{}}: expected some of {", ".join(SETTINGS)}')
        taken = {}
        for name, value in values.items():
            if name not in SETTINGS:
                raise unknown_name('setting', name, SETTINGS)
            if not isinstance(value, bool | int | float | str) or not _storable(value):
                raise ConfigError(f'{name} is {value!r:.60}: expected a number or a word')
            known = self.settings.get(name, {}).get('value')
            whole = isinstance(known, float) and type(value) is int
            taken[name] = float(value) if whole else value
        text = ', '.join(f'{name} {value}' for name, value in taken.items())
        self._answer_set(taken, answer, f'from the next episode on: {text}')

    def _answer_set(self, values: dict[str, Any], answer: Answer, text: str) -> None:
        def done(reason: str) -> None:
            answer(not reason, reason or text)
            self.refresh()

        self._set(values, done)

    def _goal(self, answer: Answer, x: float, y: float) -> None:
        if not self.goal_output.get_subscription_count():
            raise ConfigError('nobody hears goal_pose: expected a flock_sim that runs; start it')
        self.goal_output.publish(encode_goal(0, self.node.frame_id, x, y))
        answer(True, f'goal moves to {x:g}, {y:g} m')


def _storable(value: Any) -> bool:
    """Return whether a parameter can hold a value."""
    if isinstance(value, float):
        return math.isfinite(value)
    return not isinstance(value, int) or abs(value) < 2**63


def _about(descriptor: Any, value: Any) -> dict[str, Any]:
    """Return a parameter as pages are told of it."""
    ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
    choices = descriptor.additional_constraints.removeprefix('one of ')
    limits = {'low': ranges[0].from_value, 'high': ranges[0].to_value} if ranges else {}
    listed = {'choices': choices.split(', ')} if choices else {}
    kind = type(value).__name__
    return {'value': value, 'type': kind, 'doc': descriptor.description, **limits, **listed}
