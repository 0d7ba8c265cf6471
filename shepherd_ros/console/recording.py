"""The recorder of the console: a process of its own, which writes bags into one folder."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
import signal
import sys
import time

from shepherd_ros.config import ConfigError

RECORDER_STOP_TIMEOUT = 20.0  # [s] for the recorder to finish its bag
TOLD_EVERY = 1.0  # [s] between two messages on a recording
MOST_WORDS = 1000  # characters of the last words of the recorder
LISTENING = b'listening for topics'  # what the recorder says when it is ready


class Recording:
    """Starts and stops a recorder; tell(kind, **content) hears how it goes."""

    def __init__(
        self, record_dir: Path, words: Sequence[str], logs: Path, tell: Callable[..., None]
    ) -> None:
        """Record into bags in a folder; words are added to the recorder's command line."""
        self.record_dir, self.words, self.log = record_dir, list(words), logs / 'recorder.log'
        self._tell = tell
        self.process: asyncio.subprocess.Process | None = None
        self.state, self.bag, self.text = 'off', '', ''
        self.began = 0.0
        self._work: asyncio.Task[None] | None = None

    def say(self) -> None:
        """Tell how it goes."""
        seconds = 0.0 if self.state == 'off' else round(time.monotonic() - self.began, 1)
        self._tell('recording', state=self.state, bag=self.bag, seconds=seconds, text=self.text)

    def start(self, answer: Callable[[bool, str], None]) -> None:
        """Start it, and answer once it listens."""
        if self.state != 'off':
            raise ConfigError(f'{self.bag} is being recorded: expected no recording; stop it')
        stem = f'rosbag2_{datetime.now():%Y_%m_%d-%H_%M_%S}'
        names = [stem, *(f'{stem}_{k}' for k in range(1, 100))]
        try:
            self.record_dir.mkdir(parents=True, exist_ok=True)
            name = next(name for name in names if not (self.record_dir / name).exists())
        except OSError as error:
            raise ConfigError(
                f'record_dir is {self.record_dir}: expected a folder that can be written '
                f'({error.strerror})'
            ) from None
        self.state, self.bag, self.text = 'on', name, ''
        self.began = time.monotonic()
        self._work = asyncio.create_task(self._run(answer))

    async def _run(self, answer: Callable[[bool, str], None]) -> None:
        command = [sys.executable, '-m', 'shepherd_ros', 'run', 'recorder', '--output']
        with self.log.open('wb') as log:
            self.process = await asyncio.create_subprocess_exec(
                *command, str(self.record_dir / self.bag), *self.words,
                stdin=asyncio.subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip
        ready = False
        while self.process.returncode is None:
            if not ready and LISTENING in self.log.read_bytes():
                ready, self.began = True, time.monotonic()
                answer(True, f'recording into {self.bag}')
            if ready:
                self.say()
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self.process.wait(), TOLD_EVERY if ready else 0.1)
        self.text = self._last_words()
        if not ready:
            answer(False, self.text)
        self.state, self.process = 'off', None
        self.say()

    def _last_words(self) -> str:
        """Return how many messages are in the bag, which were lost, and whether it is whole."""
        lines = self.log.read_text(encoding='utf-8', errors='replace').strip().splitlines()
        first = next((k for k, line in enumerate(lines) if ' messages of ' in line), -1)
        report = [line for line in lines[first:] if not line.startswith('sent before')]
        return '; '.join(report)[:MOST_WORDS] or 'the recorder has said nothing'

    def stop(self, answer: Callable[[bool, str], None]) -> None:
        """Let it finish its bag, and answer with its last words."""
        if self.process is None or self.state != 'on' or self._work is None:
            raise ConfigError('nothing is being recorded: expected a recording; start one')
        self.state = 'stopping'
        self.say()
        self.process.send_signal(signal.SIGINT)
        asyncio.get_running_loop().call_later(RECORDER_STOP_TIMEOUT, self._kill, self.process)
        self._work.add_done_callback(
            lambda work: answer(self.text.endswith('is whole'), f'{self.bag}: {self.text}')
        )

    @staticmethod
    def _kill(process: asyncio.subprocess.Process) -> None:
        if process.returncode is None:
            process.kill()

    async def close(self) -> None:
        """Let it finish its bag."""
        if self._work is not None and self.process is not None:
            if self.process.returncode is None:
                self.process.send_signal(signal.SIGINT)
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(asyncio.shield(self._work), RECORDER_STOP_TIMEOUT)
            if self.process is not None:
                self._kill(self.process)
