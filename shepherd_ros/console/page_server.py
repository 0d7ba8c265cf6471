"""HTTP and websocket server of the console, in a thread and an event loop of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
import socket
from threading import Event, Thread
from typing import Any, Protocol

from shepherd_ros.config import ConfigError
from shepherd_ros.console.access import Access
from shepherd_ros.console.commands import CommandError, ConsoleCommand, parse_command
from shepherd_ros.console.sessions import Session
from shepherd_ros.view.assets import asset, MEDIA_TYPES
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

LONGEST_MESSAGE = 64 * 1024  # [bytes] of a page; a longer one closes it
SEND_BUFFER = 128 * 1024  # [bytes] in the kernel for each page: what waits there is out of date
PING_INTERVAL = 30.0  # [s] between two pings; a page that answers none is closed
START_TIMEOUT = 10.0  # [s] for the server to listen
SERVER_END_TIMEOUT = 30.0  # [s] for the server to end, a recording included
CHUNK = 256 * 1024  # [bytes] of a file that are sent at once
PAGE = 'console.html'
HEADERS = {
    'Cache-Control': 'no-store',
    'Content-Security-Policy': (
        "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; "
        "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    'Cross-Origin-Opener-Policy': 'same-origin',
    'Cross-Origin-Resource-Policy': 'same-origin',
    'Referrer-Policy': 'no-referrer',
    'X-Content-Type-Options': 'nosniff',
}


class Desk(Protocol):
    """What a server needs from its owner; all is called in the loop of the server."""

    def opened(self, session: Session) -> None:
        """Tell a new page what it has to know."""

    def closed(self, session: Session) -> None:
        """Forget a page."""

    def carry_out(self, session: Session, command: ConsoleCommand) -> None:
        """Carry out a command, and answer it; may raise ConfigError."""

    def file(self, name: str) -> str | None:
        """Return the path of a result with a name, None if there is none."""


class _Guarded(RequestHandler):
    """A request that is refused unless the rules of access let it pass."""

    settings: dict[str, Any]

    def set_default_headers(self) -> None:
        for name, value in HEADERS.items():
            self.set_header(name, value)
        self.clear_header('Server')

    def prepare(self) -> None:
        access: Access = self.settings['access']
        given = self.get_query_argument('token', '')
        token = given or self.get_cookie(self.settings['cookie'], '') or ''
        hosts = self.request.headers.get_list('Host')
        host = hosts[0] if len(hosts) == 1 else ''
        refused = access.refusal(host, self.request.headers.get('Origin'), token)
        if refused:
            self.set_status(403)
            self.finish(f'{refused}\n')
        elif given and access.token:
            self.set_cookie(self.settings['cookie'], given, httponly=True, samesite='Strict')

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        self.finish(f'{status_code} {self._reason}\n')


class _File(_Guarded):
    """A file of the page, or a result of a job."""

    async def get(self, name: str = PAGE) -> None:
        found = asset(name)
        path = self.settings['desk'].file(name) if found is None else str(found)
        if path is None:
            raise HTTPError(404)
        kind = MEDIA_TYPES.get('.' + path.rpartition('.')[2], 'application/json')
        self.set_header('Content-Type', kind)
        with open(path, 'rb') as file:  # noqa: PTH123  (asyncio reads a part at a time)
            while part := file.read(CHUNK):
                self.write(part)
                await self.flush()


class _Socket(WebSocketHandler, _Guarded):
    """The websocket of a page."""

    def check_origin(self, origin: str) -> bool:
        return True  # prepare() has refused foreign ones

    def open(self, *args: str, **kwargs: str) -> None:
        stream = self.ws_connection.stream if self.ws_connection else None
        if stream is not None:
            stream.set_nodelay(True)
            stream.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        self.session = Session(self._send)
        self.settings['desk'].opened(self.session)
        self.pump = asyncio.create_task(self._pump())
        self.settings['sockets'].add(self)

    async def _send(self, content: str | bytes) -> None:
        await self.write_message(content, binary=isinstance(content, bytes))

    async def _pump(self) -> None:
        with suppress(WebSocketClosedError):
            await self.session.pump()
            self.close(1008, 'too many commands')

    def on_message(self, message: str | bytes) -> None:
        session, number = self.session, None
        try:
            command = parse_command(message)
            number = command.number
            self.settings['desk'].carry_out(session, command)
        except CommandError as error:
            session.answer(id=error.number, ok=False, text=str(error))
        except ConfigError as error:
            session.answer(id=number, ok=False, text=str(error))

    def on_close(self) -> None:
        if self in self.settings['sockets']:
            self.settings['sockets'].remove(self)
            self.pump.cancel()
            self.settings['desk'].closed(self.session)

    def end(self) -> None:
        """Forget the page and close it, as the server ends."""
        self.on_close()
        self.close(1001, 'the console ends')


class PageServer:
    """Serves a desk on one port until close()."""

    def __init__(
        self,
        host: str,
        port: int,
        access: Access,
        desk: Desk,
        closing: Callable[[], Awaitable[None]],
    ) -> None:
        """
        Listen on a host and a port, 0 for any; ConfigError if that cannot be.

        closing() is awaited in the loop before it ends.
        """
        self.host, self.access, self._closing = host, access, closing
        try:
            sockets = bind_sockets(port, host)
        except OSError as error:
            raise ConfigError(
                f'host is {host!r} and port {port}: expected an address of this machine with a '
                f'free port ({error.strerror}); choose another, or 0 for any that is free'
            ) from None
        self.port = int(sockets[0].getsockname()[1])
        self.application = Application(
            [
                ('/', _File),
                ('/ws', _Socket),
                (r'/([A-Za-z0-9_.-]+)', _File),
            ],
            desk=desk,
            access=access,
            sockets=set(),
            cookie=f'shepherd_console_{self.port}',
            log_function=lambda handler: None,
            websocket_max_message_size=LONGEST_MESSAGE,
            websocket_ping_interval=PING_INTERVAL,
        )
        self._sockets = sockets
        self._ready = Event()
        self._thread = Thread(target=lambda: asyncio.run(self._serve()), name='console')
        self._thread.daemon = True
        self._thread.start()
        self._ready.wait(START_TIMEOUT)

    @property
    def address(self) -> str:
        """Return the address to open in a browser."""
        host = 'localhost' if self.host in ('0.0.0.0', '::') else self.host
        host = f'[{host}]' if ':' in host else host
        query = f'?token={self.access.token}' if self.access.token else ''
        return f'http://{host}:{self.port}/{query}'

    async def _serve(self) -> None:
        self.loop = asyncio.get_running_loop()
        self._end = asyncio.Event()
        server = HTTPServer(self.application, max_header_size=16 * 1024, max_body_size=1024)
        server.add_sockets(self._sockets)
        self._ready.set()
        await self._end.wait()
        server.stop()
        for opened in list(self.application.settings['sockets']):
            opened.end()
        await self._closing()
        await server.close_all_connections()

    def call(self, function: Callable[..., Any], *values: Any) -> None:
        """Call a function in the loop of the server, from any thread."""
        with suppress(RuntimeError):  # the loop has ended
            self.loop.call_soon_threadsafe(function, *values)

    def close(self) -> None:
        """Close all pages and end the thread."""
        self.call(self._end.set)
        self._thread.join(SERVER_END_TIMEOUT)
