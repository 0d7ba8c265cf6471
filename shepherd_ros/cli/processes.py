"""Processes of a stack: started together, stopped together whatever happens."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping, Sequence
from contextlib import contextmanager
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from shepherd_ros.bringup import Process
from shepherd_ros.cli.user_error import UserError
from shepherd_ros.resources import executable_path, quick_profile


def executable(name: str) -> str:
    """Return the path of one of our executables: beside this Python, or on the PATH."""
    path = executable_path(name)
    if path is None:
        raise UserError(
            f'executable {name!r} is neither beside {sys.executable} nor on the PATH: '
            'install the package, or source the workspace'
        )
    return str(path)


def isolate(environment: MutableMapping[str, str]) -> None:
    """Set a domain, local discovery and quick start of DDS, unless the user has set them."""
    environment.setdefault('ROS_DOMAIN_ID', str(102 + os.getpid() % 100))  # tests: 1 to 101
    environment.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    environment.setdefault('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4')
    variable, profile = quick_profile()
    environment.setdefault(variable, str(profile))


class Running:
    """Processes that were started, with their output in a file each."""

    def __init__(self, logs: Path) -> None:
        """Write output into a folder."""
        self.logs = logs
        self.started: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, processes: Sequence[Process]) -> None:
        """Start processes, each in a group of its own."""
        for process in processes:
            with (self.logs / f'{process.name}.log').open('wb') as log:
                self.started[process.name] = subprocess.Popen(
                    [executable(process.executable), *process.arguments()],
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    stdin=subprocess.DEVNULL,
                    start_new_session=True,
                )

    def ended(self, name: str) -> bool:
        """Return whether a process has ended with exit code 0."""
        return self.started[name].poll() == 0

    def check(self) -> None:
        """Raise UserError with the last words of a process that failed."""
        for name, process in self.started.items():
            if process.poll() not in (None, 0):
                text = (self.logs / f'{name}.log').read_text(errors='replace').strip()
                last = '\n'.join(text.splitlines()[-5:])
                raise UserError(f'{name} ended with exit code {process.returncode}:\n{last}')

    def stop(self) -> None:
        """Ask all to end, wait five seconds, then kill what is left."""
        for process in self.started.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        limit = time.monotonic() + 5
        for process in self.started.values():
            try:
                process.wait(max(0.0, limit - time.monotonic()))
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


@contextmanager
def running(logs: Path) -> Iterator[Running]:
    """Yield a set of processes that is stopped at the end of the block."""
    logs.mkdir(parents=True, exist_ok=True)
    processes = Running(logs)
    try:
        yield processes
    finally:
        processes.stop()
