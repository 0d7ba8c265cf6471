"""Open pages of the console: what each has yet to get, and nothing that is out of date."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from itertools import count
from typing import Any

from shepherd_ros.console.commands import ALL
from shepherd_ros.console.messages import message_text
from shepherd_ros.console.state_frames import numbered

MOST_TEXTS = 256  # that may wait for a page before it is closed
FRAMES_UNDERWAY = 2  # frames that a page may have got and not yet drawn
Write = Callable[[str | bytes], Awaitable[None]]
_numbers = count(1)


class Session:
    """
    An open page: its newest frame, the newest text of each kind, and answers in their order.

    A text or a frame that has not been written when a newer one comes is dropped. The next is
    written when the last write is done, and a frame when the page has drawn the one before the
    last: a slow page gets fewer frames, never old ones, and holds nobody up.
    """

    def __init__(self, write: Write) -> None:
        """Begin with nothing to send; pump() sends."""
        self.number = next(_numbers)
        self.watched = ALL  # shepherd whose ranges it gets
        self.sent = self.drawn = 0  # numbers of frames
        self._write = write
        self._texts: dict[str, str] = {}  # by kind, answers by number
        self._answers = count()
        self._frame: bytes | None = None
        self._news = asyncio.Event()
        self.overrun = False

    def tell(self, key: str, text: str) -> None:
        """Send a text in place of the one of that key that still waits."""
        self._texts[key] = text
        self._news.set()

    def answer(self, **content: Any) -> None:
        """Send an answer to a command."""
        self.overrun = self.overrun or len(self._texts) >= MOST_TEXTS  # it asks and does not read
        if not self.overrun:
            self._texts[f'answer {next(self._answers)}'] = message_text('answer', **content)
        self._news.set()

    def show(self, frame: bytes) -> None:
        """Send a frame in place of the one that still waits."""
        self._frame = frame
        self._news.set()

    def acknowledge(self, number: int) -> None:
        """Take note that the page has drawn a frame."""
        self.drawn = max(self.drawn, min(number, self.sent))
        self._news.set()

    @property
    def wants_frame(self) -> bool:
        """Return whether a frame would be sent now."""
        return self.sent - self.drawn < FRAMES_UNDERWAY

    async def pump(self) -> None:
        """Send what there is until the page is gone, which raises; return if it overruns."""
        while not self.overrun:
            await self._news.wait()
            self._news.clear()
            while self._texts:
                await self._write(self._texts.pop(next(iter(self._texts))))
            if self._frame is not None and self.wants_frame:
                frame, self._frame = self._frame, None
                self.sent += 1
                await self._write(numbered(frame, self.sent))
                self._news.set()
