"""Requests of the console to mux: the driver of each shepherd, and commands by hand."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import math
import re
from typing import Any

from shepherd_ros.config import ConfigError, unknown_name
from shepherd_ros.console.commands import ALL, ConsoleCommand
from shepherd_ros.console.desk import Answer
from shepherd_ros.console.page_server import PageServer
from shepherd_ros.console.state_frames import NO_DRIVER
from shepherd_ros.nodes.command_mux import AUTO
from shepherd_ros.nodes.console_calls import ServiceCalls
from shepherd_ros.nodes.console_feed import ConsoleFeed
from shepherd_ros.ros.intra_process import Output
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.ros.polling import PolledGroup, PolledTopic
from shepherd_ros.wire.decode import CdrError, decode_string
from shepherd_ros.wire.drivers import Drivers
from shepherd_ros.wire.encode import encode_command, encode_text
from shepherd_ros.wire.topics import DRIVERS, SELECT, SHEPHERD, source_topic
from std_srvs.srv import SetBool

OWN_SOURCE = 'console'  # of mux, by which pages drive
LOCK = 'mux/lock'
SELECT_TIMEOUT = 1.0  # [s] for mux to say what was selected


class DriverRequests:
    """Selects sources of mux and publishes what pages drive by hand, in the server's loop."""

    def __init__(
        self, node: ShepherdNode, feed: ConsoleFeed, group: PolledGroup, tell: Callable[..., None]
    ) -> None:
        """Create client, publisher and subscription."""
        self.node, self.feed, self.tell = node, feed, tell
        self.calls = ServiceCalls(node, {LOCK: SetBool})
        self.select_output = node.advertise(SELECT)
        self.input = PolledTopic(node, group, DRIVERS)
        self.outputs: dict[int, Output] = {}  # by shepherd
        self.server: PageServer | None = None  # once it runs
        self.sources: list[str] = []
        self.active: list[str] = []
        self.drivers: Drivers | None = None
        self.requested: dict[int, tuple[float, str]] = {}  # selected by pages, and when [s]
        self.before: dict[int, str] = {}  # what was selected for a shepherd that is driven by hand
        self.headings: dict[int, tuple[float, float]] = {}  # where it looked when it was taken
        self.commands: dict[str, Callable[..., None]] = {
            'driver': self._driver,
            'lock': self._lock,
        }

    def perform(self, command: ConsoleCommand, answer: Answer) -> None:
        """Carry out a command; raises ConfigError for values that cannot be."""
        self.commands[command.name](answer, **command.values)

    # ---- what mux says ----

    def look_for_sources(self, n_shepherds: int) -> None:
        """Find the sources of mux, and publish for each shepherd; in the executor's thread."""
        space = self.node.get_namespace().rstrip('/')
        pattern = re.compile(re.escape(f'{space}/{SELECT}/') + r'(\w+)')
        names = [pattern.fullmatch(name) for name, _ in self.node.get_service_names_and_types()]
        self.sources = sorted({match[1] for match in names if match} - {AUTO})
        self.active = [
            name for name in self.sources if self.node.count_publishers(_topic(name, 0))
        ]
        for h in range(len(self.outputs), n_shepherds):
            self.calls.add(_lock_of(h), SetBool)
            self.outputs[h] = self.node.advertise(source_topic(OWN_SOURCE), h)

    def look(self) -> None:
        """Take what mux has said of who drives, and tell it."""
        for raw in self.input.take()[-1:]:
            with suppress(CdrError, ConfigError):
                self.drivers = Drivers.from_json(decode_string(raw))
                self.say()

    def say(self) -> None:
        """Tell pages who drives."""
        state = self.drivers if self.sources else None
        self.tell(
            'drivers', present=state is not None, sources=self.sources, active=self.active,
            drivers=[] if state is None else list(state.drivers),
            selected=[] if state is None else list(state.selected),
            locked=[] if state is None else list(state.locked),
        )  # fmt: skip
        places = {name: float(k) for k, name in enumerate(self.sources)}
        drivers = () if state is None else state.drivers
        self.feed.set_drivers([places.get(name or '', NO_DRIVER) for name in drivers])

    # ---- commands ----

    def _known(self, shepherd: int) -> Drivers:
        """Return who drives; ConfigError without a mux or for a shepherd of no episode."""
        if self.drivers is None or not self.sources:
            raise ConfigError(
                'nobody tells who drives: expected a mux that runs; start it with '
                '`ros2 run shepherd_ros mux`, and its sources'
            )
        team = len(self.drivers.drivers)
        if not shepherd < team:
            raise ConfigError(f'shepherd is {shepherd}: expected 0 to {team - 1}')
        return self.drivers

    def _driver(self, answer: Answer, shepherd: int, source: str) -> None:
        self._known(shepherd)
        if source not in (AUTO, *self.sources):
            raise unknown_name('source', source, [AUTO, *self.sources])
        self._select(source, shepherd)
        self.before = {} if shepherd == ALL else self.before
        self.before.pop(shepherd, None)
        target = 'all shepherds' if shepherd == ALL else f'shepherd {shepherd}'
        answer(True, f'{source} is selected for {target}')

    def _selected(self, shepherd: int) -> str:
        """Return what is selected for a shepherd, which mux may not have said yet."""
        selected = self._known(shepherd).selected[shepherd]
        then, requested = self.requested.get(shepherd, (-math.inf, selected))
        return requested if self.node.wall() - then < SELECT_TIMEOUT else selected

    def _select(self, source: str, shepherd: int) -> None:
        team = range(len(self._known(ALL).drivers)) if shepherd == ALL else [shepherd]
        self.requested |= dict.fromkeys(team, (self.node.wall(), source))
        text = source if shepherd == ALL else f'{shepherd} {source}'
        self.select_output.publish(encode_text(text))

    def _lock(self, answer: Answer, locked: bool, shepherd: int = ALL) -> None:
        def answered(response: Any, reason: str) -> None:
            answer(response is not None and response.success, reason or response.message)

        assert self.server is not None
        self._known(shepherd)
        name = LOCK if shepherd == ALL else _lock_of(shepherd)
        self.calls.call(self.server, name, SetBool.Request(data=locked), answered)

    # ---- by hand ----

    def take(self, shepherd: int) -> None:
        """Let the console drive a shepherd: by its priority, or in place of what is selected."""
        selected = self._selected(shepherd)
        if shepherd not in self.outputs:
            raise ConfigError(f'shepherd {shepherd} is new: expected one that is known; try again')
        if selected not in (AUTO, OWN_SOURCE):
            self.before[shepherd] = selected
            self._select(OWN_SOURCE, shepherd)

    def move(self, shepherd: int, x: float, y: float, frame: str) -> None:
        """Command a velocity [m/s]; in frame body x is where it looked when it began to move."""
        if not (x or y):
            self.headings.pop(shepherd, None)
        elif frame == 'body':
            cos, sin = self.headings.setdefault(shepherd, self._heading(shepherd))
            x, y = cos * x - sin * y, sin * x + cos * y
        ns = max(self.feed.stamp, 0)
        self.outputs[shepherd].publish(encode_command(ns, self.node.frame_id, x, y))

    def _heading(self, shepherd: int) -> tuple[float, float]:
        poses = self.feed.decoded()
        if poses is None or not shepherd < len(poses[1].heading):
            return 1.0, 0.0
        x, y = poses[1].heading[shepherd].tolist()
        return x, y

    def give(self, shepherd: int) -> None:
        """Let those drive a shepherd that were selected before."""
        before = self.before.pop(shepherd, None)
        if before is not None:
            self._select(before, shepherd)


def _lock_of(shepherd: int) -> str:
    return f'{SHEPHERD.format(h=shepherd)}/{LOCK}'


def _topic(source: str, shepherd: int) -> str:
    return source_topic(source).format(h=shepherd)
