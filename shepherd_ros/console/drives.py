"""Shepherds that pages drive by hand: one page for each, and a dead-man's switch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from shepherd_ros.config import ConfigError

DEAD_MAN = 0.1  # [s] without a command of its page until it stops: zero is there within 0.2 s
GIVE_BACK_AFTER = 0.5  # [s] without one until it is given back, as a busy page goes on at once


@dataclass
class Hold:
    """A shepherd that a page drives."""

    page: int
    last_command: float  # when its last command came [s]
    stopped: bool = False  # as no command has come since


class Drives:
    """
    Lets at most one page drive a shepherd.

    take(shepherd), move(shepherd, x, y, frame) and give(shepherd) do it; a shepherd stands still
    when it is given back.
    """

    def __init__(
        self,
        take: Callable[[int], None],
        move: Callable[[int, float, float, str], None],
        give: Callable[[int], None],
    ) -> None:
        """Begin with no shepherd."""
        self._take, self._move, self._give = take, move, give
        self.holds: dict[int, Hold] = {}

    def drive(self, page: int, shepherd: int, x: float, y: float, frame: str, now: float) -> bool:
        """Move a shepherd at a velocity [m/s]; return whether the page has just taken it."""
        hold = self.holds.get(shepherd)
        if hold is not None and hold.page != page:
            raise ConfigError(
                f'shepherd {shepherd} is driven from page {hold.page}: expected one that nobody '
                'drives by hand; release it there first'
            )
        if hold is None:
            self._take(shepherd)
        self.holds[shepherd] = Hold(page, now)
        self._move(shepherd, x, y, frame)
        return hold is None

    def release(self, page: int, shepherd: int | None = None) -> bool:
        """Stop what a page drives, one shepherd or all, and give it back; return if any."""
        held = [h for h, hold in self.holds.items() if hold.page == page]
        return self._stop([h for h in held if shepherd in (None, h)])

    def drop(self, shepherd: int | None) -> bool:
        """Stop one shepherd or all, whatever page drives it, and give it back; return if any."""
        return self._stop([h for h in self.holds if shepherd in (None, h)])

    def expire(self, now: float) -> bool:
        """Stop what has had no command for too long, then give it back; return if any is."""
        silence = {h: now - hold.last_command for h, hold in self.holds.items()}
        for h, hold in self.holds.items():
            if silence[h] > DEAD_MAN and not hold.stopped:
                hold.stopped = True
                self._move(h, 0.0, 0.0, 'world')
        return self._stop([h for h in silence if silence[h] > GIVE_BACK_AFTER])

    def _stop(self, shepherds: list[int]) -> bool:
        for h in shepherds:
            del self.holds[h]
            self._move(h, 0.0, 0.0, 'world')
            self._give(h)
        return bool(shepherds)
