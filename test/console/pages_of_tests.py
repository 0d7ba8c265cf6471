"""A page without a browser: tornado's client in a thread, which keeps what it is told."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from itertools import count
import json
from threading import Thread
from typing import Any

from shepherd_ros.console.state_frames import decode_frame, StateFrame
from tornado.httpclient import AsyncHTTPClient, HTTPRequest
from tornado.websocket import (
    websocket_connect,
    WebSocketClientConnection,
    WebSocketClosedError,
)

ANSWER = 100.0  # [s] on a machine that has much to do


class TestPage:
    """An open websocket; each frame is acknowledged as it comes, unless reads is false."""

    __test__ = False

    def __init__(self, address: str, reads: bool = True, **headers: str) -> None:
        """Open it."""
        self.address, self.headers, self.reads = address, headers, reads
        self.frames: list[StateFrame] = []
        self.messages: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)
        self.order: list[str] = []  # types of messages and 'frame' as they came
        self.closed = self.disconnected = False  # by itself, by the server
        self._ids = count(1)
        self.loop = asyncio.new_event_loop()
        self.thread = Thread(target=self.loop.run_forever, daemon=True)
        self.thread.start()
        self.connection: WebSocketClientConnection = self._wait(self._open)
        self.reader: Any = None
        if reads:
            self.read()

    def read(self) -> None:
        """Begin to read what comes."""
        self.reader = asyncio.run_coroutine_threadsafe(self._read(), self.loop)

    def fetch(self, name: str) -> bytes:
        """Return a file of the server."""
        base, _, query = self.address.partition('?')
        url = base + name + (f'?{query}' if query else '')
        return bytes(self._wait(lambda: AsyncHTTPClient().fetch(url)).body)

    def _wait(self, work: Any) -> Any:
        async def done() -> Any:
            return await work()

        return asyncio.run_coroutine_threadsafe(done(), self.loop).result(ANSWER)

    async def _open(self) -> WebSocketClientConnection:
        base, _, query = self.address.partition('?')
        url = base.replace('http', 'ws', 1) + 'ws' + (f'?{query}' if query else '')
        request = HTTPRequest(url, headers=self.headers, request_timeout=ANSWER)
        return await websocket_connect(request)

    async def _read(self) -> None:
        with suppress(WebSocketClosedError):
            while (message := await self.connection.read_message()) is not None:
                await self._take(message)
        self.disconnected = True

    async def _take(self, message: str | bytes) -> None:
        if isinstance(message, bytes):
            frame = decode_frame(message)
            self.frames.append(frame)
            self.order.append('frame')
            await self._send(json.dumps({'do': 'ack', 'frame': frame.number}))
        else:
            content = json.loads(message)
            self.messages[content['type']].append(content)
            self.order.append(content['type'])

    def last(self, kind: str) -> dict[str, Any]:
        """Return the newest message of a type, {} before the first."""
        return self.messages[kind][-1] if self.messages[kind] else {}

    def send(self, do: str, **fields: Any) -> int:
        """Give a command; return its number."""
        number = next(self._ids)
        self.send_raw(json.dumps({'do': do, 'id': number, **fields}))
        return number

    def send_raw(self, content: str | bytes) -> None:
        """Send any message."""
        self._wait(lambda: self._send(content))

    async def _send(self, content: str | bytes) -> None:
        await self.connection.write_message(content, binary=isinstance(content, bytes))

    def answer(self, number: int) -> dict[str, Any] | None:
        """Return the answer to a command, None before it has come."""
        return next((a for a in self.messages['answer'] if a['id'] == number), None)

    def ask(self, until: Callable[..., Any], do: str, **fields: Any) -> dict[str, Any]:
        """Give a command and return its answer; until(condition, what) waits."""
        number = self.send(do, **fields)
        return until(lambda: self.answer(number), f'answer to {do}')

    def close(self) -> None:
        """Close it and end its thread."""
        if self.closed:
            return
        self.loop.call_soon_threadsafe(self.connection.close)
        if self.reader is not None:
            self.reader.result(ANSWER)
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join()
        self.closed = True
