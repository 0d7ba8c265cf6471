"""Progress of long work on stderr: a bar on a terminal, elsewhere a line now and then."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import sys
import time
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

if TYPE_CHECKING:
    from shepherd_ros.rosbag2.bag import Bag

LINE_PERIOD = 30.0  # [s] between two lines where stderr is no terminal
Show = Callable[..., None]  # show(done, total=None, text='')


class _Lines:
    """Lines for a pipe or a file; none for short work."""

    def __init__(self, what: str, total: float | None) -> None:
        self.what, self.total, self.shown_at = what, total, time.monotonic()

    def show(self, done: float, total: float | None = None, text: str = '') -> None:
        """Print a line if the last one is long ago."""
        self.total = self.total if total is None else total
        if time.monotonic() - self.shown_at < LINE_PERIOD:
            return
        self.shown_at = time.monotonic()
        share = f'{done / self.total:.0%}' if self.total else f'{done:g}'
        print(f'{self.what}: {share} {text}'.rstrip(), file=sys.stderr, flush=True)


@contextmanager
def progress(what: str, total: float | None = None, quiet: bool = False) -> Iterator[Show]:
    """Yield show(done, total=None, text=''), which reports progress on stderr unless quiet."""
    if quiet:
        yield lambda done, total=None, text='': None
    elif not sys.stderr.isatty():
        yield _Lines(what, total).show
    else:
        # lines on stdout stand above the bar, unless they go elsewhere
        with Progress(
            TextColumn('{task.description}'), BarColumn(), TaskProgressColumn(),
            TimeElapsedColumn(), TimeRemainingColumn(), console=Console(stderr=True),
            transient=True, redirect_stdout=sys.stdout.isatty(),
        ) as bar:  # fmt: skip
            task = bar.add_task(what, total=total)

            def show(done: float, total: float | None = None, text: str = '') -> None:
                description = f'{what} {text}'.rstrip()
                bar.update(task, completed=done, total=total, description=description)

            yield show


@contextmanager
def reading(bag: Bag) -> Iterator[None]:
    """Show how far a bag is read, by the log times of its messages."""
    first, seconds = bag.start_ns, max(bag.end_ns - bag.start_ns, 1) / 1e9
    with progress('reading', seconds) as show:

        def tell(ns: int) -> None:
            done = max(ns - first, 0) / 1e9
            show(done, text=f'{bag.path.name}, {done:.0f} of {seconds:.0f} s')

        bag.on_time = tell
        yield
