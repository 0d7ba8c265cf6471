"""Jobs of the console: processes of their own, so that they neither hold up nor end the node."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
import json
import os
from pathlib import Path
import sys
from typing import Any

from shepherd_ros.config import ConfigError

MOST_JOBS = 3  # at a time
LONGEST_LINE = 2**24  # [bytes] that a job says at once
LAST_WORDS = 2000  # [bytes] of what a job has written to stderr, if it fails
JOB_END_TIMEOUT = 3.0  # [s] for a job to end
OnLine = Callable[[dict[str, Any]], None]


class Job:
    """
    A process that does one thing: it reads JSON lines and writes JSON lines.

    on_line(line) is called in the loop for each line; the last has `result` or `error`.
    """

    def __init__(
        self, kind: str, request: Mapping[str, Any], folder: Path, on_line: OnLine
    ) -> None:
        """Begin in the running loop; results are files in a folder."""
        self.kind, self.on_line = kind, on_line
        self.process: asyncio.subprocess.Process | None = None
        self.ended = False
        self._errors = folder / f'{kind}_{id(self)}.log'
        self.work = asyncio.create_task(self._run(dict(request)))

    async def _run(self, request: dict[str, Any]) -> None:
        last: dict[str, Any] = {}
        try:
            with self._errors.open('wb') as errors:
                self.process = await asyncio.create_subprocess_exec(
                    sys.executable, '-m', 'shepherd_ros.console.job', self.kind,
                    stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, stderr=errors,
                    limit=LONGEST_LINE, start_new_session=True,
                )  # fmt: skip
            self.say(request)
            assert self.process.stdout is not None
            async for line in self.process.stdout:
                last = json.loads(line)
                self.on_line(last)
            await self.process.wait()
            if not last.keys() & {'result', 'error'}:
                self.on_line({'error': self._last_words()})
        except (OSError, ValueError) as error:
            self.on_line({'error': f'{self.kind} cannot be done: {error}'})
        finally:
            self.ended = True
            self._errors.unlink(missing_ok=True)
            self._kill()
            if self.process is not None:
                await self.process.wait()

    def _last_words(self) -> str:
        words = self._errors.read_bytes()[-LAST_WORDS:].decode(errors='replace').split('\n')
        last_line = next((word for word in reversed(words) if word.strip()), 'it says nothing')
        return f'{self.kind} has ended without a result: {last_line}'

    def say(self, content: Mapping[str, Any]) -> None:
        """Send a line, unless the process is gone."""
        if self.process is not None and self.process.stdin is not None:
            with suppress(OSError, RuntimeError):
                self.process.stdin.write(json.dumps(content).encode() + b'\n')

    def cancel(self) -> None:
        """End it without another word."""
        self.ended = True
        self.work.cancel()
        self._kill()

    def _kill(self) -> None:
        if self.process is not None and self.process.returncode is None:
            with suppress(ProcessLookupError):
                self.process.kill()


class Jobs:
    """Jobs that run, by number."""

    def __init__(self, folder: Path) -> None:
        """Keep results in a folder."""
        self.folder = folder
        self.running: dict[int, Job] = {}
        self._numbers = 0

    def start(self, kind: str, request: Mapping[str, Any], on_line: Callable[..., None]) -> int:
        """Start a job and return its number; on_line(number, line) gets its output."""
        self.running = {n: job for n, job in self.running.items() if not job.ended}
        if len(self.running) >= MOST_JOBS:
            raise ConfigError(
                f'{len(self.running)} jobs run: expected less than {MOST_JOBS}; wait or cancel'
            )
        self._numbers += 1
        number = self._numbers
        request = dict(request) | {'folder': str(self.folder)}
        self.running[number] = Job(kind, request, self.folder, lambda line: on_line(number, line))
        return number

    def cancel(self, number: int) -> bool:
        """End a job; return whether it was running."""
        job = self.running.pop(number, None)
        if job is None or job.ended:
            return False
        job.cancel()
        return True

    async def close(self) -> None:
        """End all."""
        work = [job.work for job in self.running.values()]
        for number in list(self.running):
            self.cancel(number)
        await asyncio.gather(*work, return_exceptions=True)


def bag_path(record_dir: Path, name: str) -> Path:
    """Return the path of a bag in a folder; ConfigError unless it is a name of one in it."""
    path = record_dir / name
    inside = name not in ('', '.', '..') and os.sep not in name and '\0' not in name
    if not inside or path.is_symlink() or not path.exists():
        raise ConfigError(
            f'bag is {name!r}: expected the name of one in {record_dir}; list_bags lists them'
        )
    return path
