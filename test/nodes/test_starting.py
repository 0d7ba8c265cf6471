"""The start of a node: while it imports, and where nothing can run."""

from pathlib import Path
import signal
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from shepherd_ros.config import ConfigError
from shepherd_ros.nodes import executables
from shepherd_ros.ros import runtime
from shepherd_ros.ros.runtime import init_rclpy

ROOT = Path(__file__).resolve().parents[2]
# runs a command and sends Ctrl-C at the import of a number, counted from the first of ours
CUT = """
import itertools, os, signal, sys
count, started = itertools.count(), []
def cut(event, arguments):
    if event == 'import':
        started.extend(arguments[:1] if arguments[0] == 'shepherd_ros.entry_points' else [])
        if started and next(count) == {number}:
            os.kill(os.getpid(), signal.SIGINT)
sys.addaudithook(cut)
sys.argv[1:] = {words}
from shepherd_ros.entry_points import {command}
sys.exit({command}())
"""


@pytest.mark.parametrize('number', [2, 9, 40])
@pytest.mark.parametrize('words', [['metrics'], ['shepherd', 'demo']])
def test_ctrl_c_at_any_import_ends_a_command_without_a_word(
    words: list[str], number: int, tmp_path: Path
) -> None:
    code = CUT.format(number=number, command=words[0], words=words[1:])
    done = subprocess.run([sys.executable, '-c', code], cwd=tmp_path, capture_output=True)
    assert done.returncode in (-signal.SIGINT, 130)
    assert done.stdout + done.stderr == b''


@pytest.mark.parametrize('name', sorted([*executables.FILES, 'pierson']))
def test_ctrl_c_while_an_executable_imports_ends_it_without_a_traceback(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    handlers = []

    def imported(path: str) -> Any:
        handlers.append(signal.getsignal(signal.SIGINT))
        file = path.rpartition('.')[2]
        assert (ROOT / 'shepherd_ros' / 'nodes' / f'{file}.py').is_file()
        return SimpleNamespace(main=lambda: 3, pierson=lambda: 3)

    monkeypatch.setattr(executables, 'import_module', imported)
    before = signal.getsignal(signal.SIGINT)
    try:
        assert getattr(executables, name)() == 3
    finally:
        signal.signal(signal.SIGINT, before)
    assert handlers == [signal.SIG_DFL]


@pytest.mark.parametrize('domain', ['abc', '-1', '500'])
def test_a_domain_that_cannot_be_is_named(monkeypatch: pytest.MonkeyPatch, domain: str) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', domain)
    with pytest.raises(ConfigError, match=f"ROS_DOMAIN_ID is '{domain}': expected a number"):
        init_rclpy()


@pytest.mark.parametrize(
    ('output', 'message'),
    [
        (
            "failed to initialize logging: Failed to create log directory '/proc/a': 2, at /b.c:1",
            "Failed to create log directory '/proc/a': 2: expected a folder in which logs",
        ),
        ('failed to initialize rcl: error not set', "ROS_SECURITY_KEYSTORE is '/keys'"),
    ],
)
def test_what_rcl_cannot_begin_with_is_a_sentence(
    monkeypatch: pytest.MonkeyPatch, output: str, message: str
) -> None:
    def init(**options: Any) -> None:
        raise runtime._rclpy.RCLError(output)

    monkeypatch.setattr(rclpy, 'init', init)
    monkeypatch.setenv('ROS_SECURITY_ENABLE', 'true')
    monkeypatch.setenv('ROS_SECURITY_KEYSTORE', '/keys')
    with pytest.raises(ConfigError, match=message):
        init_rclpy()
