"""Desk of the console: open pages, what each is told, and who carries out its commands."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
import time
from typing import Any, Protocol

from shepherd_ros import __version__
from shepherd_ros.console.commands import ALL, COMMAND_KINDS, ConsoleCommand
from shepherd_ros.console.drives import DEAD_MAN, Drives
from shepherd_ros.console.messages import message_text
from shepherd_ros.console.sessions import Session
from shepherd_ros.sim.lidar_layout import CHANNELS, PAPER_CHANNELS

PROTOCOL = 1  # version of frames and messages
DRIVES_PERIOD = 0.01  # [s] between two looks at who is silent
Answer = Callable[[bool, str], None]


class Graph(Protocol):
    """What a desk needs from what it shows and drives; all is called in the loop of the server."""

    def perform(self, command: ConsoleCommand, answer: Answer) -> None:
        """Carry out a command and answer whether that was done; may raise ConfigError."""

    def watch(self, shepherds: set[int]) -> None:
        """Hear the lidars of these shepherds."""

    def frame(self, shepherd: int) -> bytes | None:
        """Return the newest state with the ranges of a shepherd, None before the first."""

    def curves(self) -> dict[str, Any] | None:
        """Return the metrics of the running episode so far, None before the first."""

    def take(self, shepherd: int) -> None:
        """Let the console drive a shepherd."""

    def move(self, shepherd: int, x: float, y: float, frame: str) -> None:
        """Command a velocity [m/s], in frame world or body."""

    def give(self, shepherd: int) -> None:
        """Let those drive a shepherd that drove it before."""


class ConsoleDesk:
    """Tells every page what is latched and what is new; all is called in the server's loop."""

    def __init__(self, graph: Graph, about: Mapping[str, Any]) -> None:
        """Serve a graph; about is what a page is told of it when it opens."""
        self.graph, self.about = graph, dict(about)
        self.sessions: dict[int, Session] = {}
        self.latched: dict[str, str] = {}
        self.drives = Drives(graph.take, graph.move, graph.give)
        self.own: dict[str, Callable[..., None]] = {
            'ack': self._ack,
            'watch': self._watch,
            'drive': self._drive,
            'release': self._release,
            'blur': self._release,
        }
        self.results: Callable[[str], str | None] = lambda name: None
        self.on_open: list[Callable[[Session], None]] = []
        self.on_close: list[Callable[[Session], None]] = []
        self._watching = False

    # ---- what pages are told ----

    def opened(self, session: Session) -> None:
        """Tell a new page all that is latched, and the last state."""
        self.sessions[session.number] = session
        session.tell('hello', self._hello(session))
        for key, text in self.latched.items():
            session.tell(key, text)
        curves = self.graph.curves()
        if curves is not None:
            session.tell('curves', message_text('curves', **curves))
        self._show_to(session)
        self._tell_pages()
        for callback in self.on_open:
            callback(session)

    def _hello(self, session: Session) -> str:
        """Return the first message of a page."""
        channels = [CHANNELS[name] for name in PAPER_CHANNELS]
        commands = {
            name: {
                'doc': kind.doc,
                'fields': {key: about.about() for key, about in kind.fields.items()},
            }
            for name, kind in COMMAND_KINDS.items()
        }
        return message_text(
            'hello',
            protocol=PROTOCOL,
            version=__version__,
            page=session.number,
            dead_man=DEAD_MAN,
            channels=[{'name': c.name, 'color': c.color, 'hit': c.hit} for c in channels],
            commands=commands,
            **self.about,
        )

    def describe(self, **about: Any) -> None:
        """Tell pages more of what message `hello` says."""
        self.about |= about
        for session in self.sessions.values():
            session.tell('hello', self._hello(session))

    def closed(self, session: Session) -> None:
        """Forget a page; what it drives stops."""
        del self.sessions[session.number]
        self.drives.release(session.number)
        self._hear_watched()
        self._tell_pages()
        for callback in self.on_close:
            callback(session)

    def tell(self, kind: str, /, **content: Any) -> None:
        """Tell all pages, and those that open later."""
        text = message_text(kind, **content)
        if self.latched.get(kind) != text:
            self.latched[kind] = text
            self.say(kind, text)

    def say(self, key: str, text: str) -> None:
        """Send a text to all pages."""
        for session in self.sessions.values():
            session.tell(key, text)

    def show(self) -> None:
        """Send the newest state to all pages that have drawn theirs, and to others later."""
        frames: dict[int, bytes | None] = {}
        for session in self.sessions.values():
            if session.watched not in frames:
                frames[session.watched] = self.graph.frame(session.watched)
            frame = frames[session.watched]
            if frame is not None:
                session.show(frame)

    def _show_to(self, session: Session) -> None:
        frame = self.graph.frame(session.watched)
        if frame is not None:
            session.show(frame)

    def _tell_pages(self) -> None:
        holds = {str(h): hold.page for h, hold in sorted(self.drives.holds.items())}
        self.tell('pages', count=len(self.sessions), driven=holds)

    def _hear_watched(self) -> None:
        self.graph.watch({s.watched for s in self.sessions.values() if s.watched >= 0})

    # ---- what pages ask for ----

    def carry_out(self, session: Session, command: ConsoleCommand) -> None:
        """Carry out a command of a page."""

        def answer(ok: bool, text: str) -> None:
            session.answer(id=command.number, ok=ok, text=text)

        if command.name == 'driver':  # whoever drives by hand lets go
            shepherd = command.values['shepherd']
            if self.drives.drop(None if shepherd == ALL else shepherd):
                self._tell_pages()
        if command.name in self.own:
            self.own[command.name](session, answer, **command.values)
        else:
            self.graph.perform(command, answer)

    def file(self, name: str) -> str | None:
        """Return the path of a result with a name, None if there is none."""
        return self.results(name)

    def _ack(self, session: Session, answer: Answer, frame: int) -> None:
        session.acknowledge(frame)

    def _watch(self, session: Session, answer: Answer, shepherd: int) -> None:
        session.watched = shepherd
        self._hear_watched()
        self._show_to(session)
        answer(True, 'no lidar' if shepherd < 0 else f'lidar of shepherd {shepherd}')

    def _drive(
        self,
        session: Session,
        answer: Answer,
        shepherd: int,
        x: float,
        y: float,
        frame: str = 'world',
    ) -> None:
        if self.drives.drive(session.number, shepherd, x, y, frame, time.monotonic()):
            self._tell_pages()
            answer(True, f'page {session.number} drives shepherd {shepherd}')
            if not self._watching:
                self._watching = True
                asyncio.get_running_loop().call_later(DRIVES_PERIOD, self._look_at_drives)

    def _release(self, session: Session, answer: Answer, shepherd: int | None = None) -> None:
        if self.drives.release(session.number, shepherd):
            self._tell_pages()
        answer(True, 'released')

    def _look_at_drives(self) -> None:
        """Stop shepherds whose pages are silent, and look again while any is driven."""
        if self.drives.expire(time.monotonic()):
            self._tell_pages()
        self._watching = bool(self.drives.holds)
        if self._watching:
            asyncio.get_running_loop().call_later(DRIVES_PERIOD, self._look_at_drives)
