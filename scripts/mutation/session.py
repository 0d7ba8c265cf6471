"""Tests of a room in one process: which test runs which line, and forks that run mutants."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
import ctypes
import json
import os
from pathlib import Path
import resource
import signal
from time import monotonic
from typing import Any

import coverage
import pytest

PR_SET_PDEATHSIG = 1  # of Linux: a fork ends with its parent
Item = pytest.Item
Items = dict[str, Item]
SLOWEST = 20.0  # [s] of CPU; longer tests kill no mutants


def options() -> list[str]:
    """Return options of pytest: no limits but ours, and one place for files of tests."""
    folder = os.environ['HYPOTHESIS_STORAGE_DIRECTORY']
    settings = ('timeout=0', 'faulthandler_timeout=0')
    return [f'--basetemp={folder}/tests', *(f'--override-ini={one}' for one in settings)]


def cpu() -> float:
    """Return the CPU time of this process and of those that it started [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def forked(work: Callable[[], int], cpu_limit: float, wall_limit: float) -> int | None:
    """Return the exit status of the work done in a fork, None where it takes too long."""
    child = os.fork()
    if not child:
        os.setpgid(0, 0)
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        signal.signal(signal.SIGXCPU, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_CPU, (int(cpu_limit) + 1, int(cpu_limit) + 3))
        status = 1
        try:
            status = work()
        finally:
            os._exit(status)
    status, end = _wait(child, monotonic() + wall_limit)
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # with what it has started
    if not end:
        os.waitpid(child, 0)
        return None
    code = os.waitstatus_to_exitcode(status)
    return None if code in (-signal.SIGXCPU, -signal.SIGKILL) else code


def _wait(child: int, deadline: float) -> tuple[int, bool]:
    pause = 0.002
    while monotonic() < deadline:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return status, True
        signal.sigtimedwait([], pause)
        pause = min(2 * pause, 0.1)
    return 0, False


class Loop:
    """A plug-in of pytest that runs collected tests in its own way."""

    def __init__(self, work: Callable[[Loop, list[pytest.Item]], None]) -> None:
        """Do the work with the collected tests."""
        self.work, self.failed = work, False

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run the tests; pytest's own loop does not."""
        self.work(self, session.items)
        return True

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Remember a failure."""
        self.failed |= report.failed

    def passes(self, items: Sequence[pytest.Item]) -> bool:
        """Return whether all tests pass, up to the first that does not."""
        self.failed = False
        for item, after in zip(items, [*items[1:], None], strict=True):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            if self.failed:
                return False
        return True


def _too_slow(*_: Any) -> None:
    raise TimeoutError


def trace(files: Sequence[str], folders: Sequence[str], root: Path, out: Path) -> None:
    """Write which tests pass, their CPU time, and which lines each runs, 'import' among them."""
    recorder = coverage.Coverage(data_file=None, include=[str(root / path) for path in files])
    tests: dict[str, float] = {}

    def run(loop: Loop, items: list[pytest.Item]) -> None:
        signal.signal(signal.SIGPROF, _too_slow)
        for item, after in zip(items, [*items[1:], None], strict=True):
            recorder.switch_context(item.nodeid)
            begin, loop.failed = cpu(), False
            signal.setitimer(signal.ITIMER_PROF, SLOWEST)
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            signal.setitimer(signal.ITIMER_PROF, 0)
            if not loop.failed:
                tests[item.nodeid] = cpu() - begin

    recorder.start()
    recorder.switch_context('import')
    pytest.main([*options(), *folders], plugins=[Loop(run)])
    recorder.stop()
    data = recorder.get_data()
    lines = {path: data.contexts_by_lineno(str(root / path)) for path in files}
    out.write_text(json.dumps({'tests': tests, 'lines': lines}), encoding='utf-8')


def collected(folders: Sequence[str], work: Callable[[Loop, Items], None]) -> None:
    """Do the work with the tests of some folders, imported but not yet run."""

    def run(loop: Loop, items: list[pytest.Item]) -> None:
        work(loop, {item.nodeid: item for item in items})

    pytest.main([*options(), *folders], plugins=[Loop(run)])


def alone(tests: Sequence[str]) -> bool:
    """Return whether tests pass in a session of their own."""
    return pytest.main([*options(), '-x', *tests]) == 0


def read_trace(path: Path) -> tuple[dict[str, float], dict[str, dict[int, list[str]]]]:
    """Return CPU time by test, and tests by file and line."""
    data = json.loads(path.read_text(encoding='utf-8'))
    lines = {
        file: {int(line): names for line, names in by_line.items()}
        for file, by_line in data['lines'].items()
    }
    return data['tests'], lines
