"""The console node: a page in a browser that shows a running graph and drives it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.exceptions import InvalidHandle
from shepherd_ros.config import ConfigError
from shepherd_ros.console.access import make_access
from shepherd_ros.console.archive import Archive
from shepherd_ros.console.commands import ConsoleCommand
from shepherd_ros.console.desk import Answer, ConsoleDesk
from shepherd_ros.console.frame_pace import FramePace
from shepherd_ros.console.live_values import LiveValues
from shepherd_ros.console.metric_history import Curves
from shepherd_ros.console.page_server import PageServer
from shepherd_ros.nodes.console_feed import ConsoleFeed
from shepherd_ros.nodes.console_mux import DriverRequests
from shepherd_ros.nodes.console_reports import ConsoleReports
from shepherd_ros.nodes.console_world import WorldRequests
from shepherd_ros.ros.node import OK, ShepherdNode
from shepherd_ros.ros.runtime import run

METRICS_PERIOD = 0.1  # [s] between two looks at metrics
IDLE_PERIOD = 0.2  # [s] between two looks at states while no page is open
REPORT_PERIOD = 1.0  # [s] between two looks at diagnostics, and for new topics
HIGHEST_PORT = 65535
HIGHEST_RATE = 240.0  # frames per second


class ConsoleNode(ShepherdNode):
    """
    Serves the page and its websocket, shows what the graph says and does what the page asks for.

    rclpy runs in the main thread, which sees timers and answers of services; the server and the
    looks at topics run in a thread of their own.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Create the node and listen on its port."""
        super().__init__('console', **kwargs)
        self.executor_kind = 'single'  # it only sees timers and services
        host: str = self.option('host', '127.0.0.1', 'address to listen on; 0.0.0.0: all')
        port: int = self.option(
            'port', 8080, 'port to listen on; 0: any that is free', low=0, high=HIGHEST_PORT
        )
        token: str = self.option(
            'token', '', 'token that opens the page; empty: none on the loopback device, '
            'elsewhere one that is made',
        )  # fmt: skip
        hosts: list[str] = self.option(
            'allowed_hosts', [''], 'other names by which browsers may call this machine'
        )
        record_dir: str = self.option(
            'record_dir', 'bags', 'folder of the bags that are recorded, listed and replayed'
        )
        free: float = self.option(
            'frame_rate', 60.0, 'most frames per second for each page', low=1.0, high=HIGHEST_RATE
        )
        busy: float = self.option(
            'busy_frame_rate', 20.0, 'the same while less than half a processor is spare, so that '
            'pages do not slow the graph down', low=1.0, high=HIGHEST_RATE,
        )  # fmt: skip
        self.pace = FramePace(free, busy)
        self.tasks: deque[Callable[[], None]] = deque()  # for the executor's thread
        self.task_guard = self.create_guard_condition(self._run_tasks)
        self.access = make_access(host, token, hosts)
        self.place = host, port
        self.past = Curves()
        folder = Path(record_dir).expanduser().absolute()
        self.desk = ConsoleDesk(
            self, {'namespace': self.get_namespace(), 'record_dir': str(folder)}
        )
        self.feed = ConsoleFeed(self, self.desk.tell)
        self.reports = ConsoleReports(self, self.feed.group)
        self.world = WorldRequests(self, self.desk.tell)
        self.mux = DriverRequests(self, self.feed, self.feed.group, self.desk.tell)
        self.archive = Archive(self.desk, folder, self._recorder_words())
        self.values = LiveValues(self.desk, self.archive.jobs, self.feed.moment)
        self.server: PageServer | None = None
        self.starter = self.timer(0.0, self._start)
        self.timer(REPORT_PERIOD, self.look_for_topics)

    def _start(self) -> None:
        """Listen: when the node runs, and not when only its help is shown."""
        self.starter.cancel()
        self.server = PageServer(*self.place, self.access, self.desk, self.archive.close)
        self.world.server = self.mux.server = self.server
        for look in (self._look, self._look_at_metrics, self._look_at_reports):
            self.server.call(look)
        self.get_logger().info(f'open {self.server.address}')

    def _recorder_words(self) -> list[str]:
        """Return the words by which a recorder hears the same graph as this node."""
        space = self.get_namespace()
        return ['--ros-args', '-r', '__node:=console_recorder', '-r', f'__ns:={space}']

    @property
    def address(self) -> str:
        """Return the address to open in a browser, '' before the server listens."""
        return '' if self.server is None else self.server.address

    def end(self) -> int:
        """Close all pages and return the exit code."""
        self.close()
        return 0

    def close(self) -> None:
        """Close all pages and end the server."""
        if self.server is not None:
            self.server.close()
            self.server = None

    def destroy_node(self) -> None:
        """End the server, then the node."""
        self.close()
        super().destroy_node()

    # ---- what pages are shown, in the server's thread ----

    def _again(self, seconds: float, look: Callable[[], None]) -> None:
        if self.server is not None:
            self.server.loop.call_later(seconds, look)

    def _look(self) -> None:
        """Show the newest state, and tell who drives."""
        period = self.pace.period(self.wall()) if self.desk.sessions else IDLE_PERIOD
        self._again(period, self._look)
        episode = self.feed.episode
        self.mux.look()
        if self.feed.look():
            self.desk.show()
        if self.feed.episode is not episode:
            self.past.clear()
            self.reports.values.clear()
            self.in_executor(self.look_for_topics)
            self.world.refresh()

    def _look_at_metrics(self) -> None:
        """Tell the newest metrics."""
        self._again(METRICS_PERIOD, self._look_at_metrics)
        episode, step = self.feed.episode, self.feed.step
        if self.reports.hear_metrics() and episode is not None and step >= 0:
            self.desk.tell(
                'metrics', episode=episode.number, step=step, values=self.reports.values
            )
            self.past.add(step, self.reports.values)

    def _look_at_reports(self) -> None:
        """Tell the reports of all nodes, and what the world is set to."""
        self._again(REPORT_PERIOD, self._look_at_reports)
        reports = self.reports.hear_reports()
        self.desk.tell('metric_names', metrics=self.reports.metric_names())
        self.desk.tell('diagnostics', reports=reports)
        self.world.look(reports)
        self.mux.say()

    def look_for_topics(self) -> None:
        """Find metrics, sources of mux and shepherds that are new; in the executor's thread."""
        self.reports.look_for_metrics()
        episode = self.feed.episode
        self.mux.look_for_sources(0 if episode is None else episode.n_shepherds)

    def frame(self, shepherd: int) -> bytes | None:
        """Return the newest state with the ranges of a shepherd, None before the first."""
        return self.feed.frame(shepherd)

    def curves(self) -> dict[str, Any] | None:
        """Return the metrics of the running episode so far, None before the first."""
        episode = self.feed.episode
        if episode is None or not self.past.steps:
            return None
        return {'episode': episode.number, **self.past.content()}

    def watch(self, shepherds: set[int]) -> None:
        """Hear the lidars of these shepherds."""
        self.in_executor(lambda: self.feed.watch(shepherds))

    # ---- what pages ask for, in the server's thread ----

    def in_executor(self, function: Callable[[], None]) -> None:
        """Call a function in the executor's thread, where rclpy makes and ends subscriptions."""
        self.tasks.append(function)
        with suppress(InvalidHandle):  # the node ends
            self.task_guard.trigger()

    def _run_tasks(self) -> None:
        """Call what waits; in the executor's thread."""
        while self.tasks:
            self.tasks.popleft()()

    def perform(self, command: ConsoleCommand, answer: Answer) -> None:
        """Carry out a command."""
        for part in (self.world, self.mux):
            if command.name in part.commands:
                part.perform(command, answer)
                return
        raise ConfigError(f'{command.name} cannot be done here')

    def take(self, shepherd: int) -> None:
        """Let the console drive a shepherd."""
        self.mux.take(shepherd)

    def move(self, shepherd: int, x: float, y: float, frame: str) -> None:
        """Command a velocity [m/s], in frame world or body."""
        self.mux.move(shepherd, x, y, frame)

    def give(self, shepherd: int) -> None:
        """Let those drive a shepherd that drove it before."""
        self.mux.give(shepherd)

    def diagnose(self) -> list[DiagnosticStatus]:
        """Return how many pages are open."""
        pages = len(self.desk.sessions)
        return [self.status('pages', OK, f'{pages} open', address=self.address)]


def main() -> int:
    """Show a running graph in a browser and drive it from there."""
    return run(ConsoleNode, 'console', main.__doc__ or '')
