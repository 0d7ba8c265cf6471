"""
Commands in forks of a process that has imported torch, which saves 3 s each time.

A server forks; commands of a folder are clients that hand it their words, folder, environment and
streams, pass signals on, and end with the exit code of the fork.
"""

from __future__ import annotations

import atexit
from collections.abc import Iterator
from contextlib import contextmanager, suppress
import ctypes
import json
import multiprocessing as mp
from multiprocessing.forkserver import _forkserver  # type: ignore[attr-defined]
import os
from pathlib import Path
import runpy
import select
import signal
import socket
import sys
import tempfile
import traceback
from types import FrameType
from typing import Any

from installed import executables

FORKS = mp.get_context('forkserver')
FORKS.set_forkserver_preload(
    [
        'shepherd_ros.nodes.compose',
        'rosgraph_msgs.msg',
        'shepherd_ros.learning.train_ppo',
        'torch.distributed.run',
        'compiled_laws',
    ]
)
DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG
COMMANDS = ('shepherd', 'python', 'pierson', 'strombom', 'random')
BIN = executables()
# two processes of a command, which comes after this
TORCHRUN = ['-m', 'torch.distributed.run', '--standalone', '--nproc-per-node', '2', '--no-python']
CLIENT = """#!{python} -IS
import json, os, signal, socket, sys
server = socket.socket(socket.AF_UNIX)
server.connect({address!r})
told = json.dumps([sys.argv, os.getcwd(), dict(os.environ)]).encode()
socket.send_fds(server, [len(told).to_bytes(4, 'little')], [0, 1, 2])
server.sendall(told)
pid = int.from_bytes(server.recv(4), 'little')
for number in signal.SIGINT, signal.SIGTERM:
    signal.signal(number, lambda number, frame: os.kill(pid, number))
code = int.from_bytes(server.recv(4), 'little', signed=True)
if code < 0:
    signal.signal(-code, signal.SIG_DFL)
    os.kill(os.getpid(), -code)
sys.exit(code)
"""


@contextmanager
def forked_commands() -> Iterator[Path]:
    """Lend a folder with the commands, for PATH."""
    with tempfile.TemporaryDirectory(prefix='forks') as name, socket.socket(socket.AF_UNIX) as s:
        address = str(Path(name, 'server'))
        s.bind(address)
        s.listen()
        server = FORKS.Process(target=_serve, args=(s,))
        server.start()
        for command in COMMANDS:
            path = Path(name, command)
            path.write_text(CLIENT.format(python=sys.executable, address=address))
            path.chmod(0o755)
        try:
            yield Path(name)
        finally:
            server.kill()
            server.join()


def die_with_tests() -> None:
    """Let this fork end when the process of the tests ends, in whatever way."""
    ctypes.CDLL(None).prctl(DIE_WITH_PARENT, signal.SIGKILL)
    os.close(_forkserver._forkserver_alive_fd)  # type: ignore[attr-defined]


def _reap(number: int, frame: FrameType | None) -> None:
    """Wait for forks that have ended, so that their CPU time counts as that of the tests."""
    with suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def _serve(listener: socket.socket) -> None:
    """Fork for each client, for ever."""
    die_with_tests()
    signal.signal(signal.SIGCHLD, _reap)
    while True:
        client, _ = listener.accept()
        if os.fork() == 0:
            listener.close()
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            _attend(client)
            os._exit(0)
        client.close()


def _attend(client: socket.socket) -> None:
    """Run what a client asks for in a fork, and tell its end."""
    head, streams, _, _ = socket.recv_fds(client, 4, 3)
    size, text = int.from_bytes(head, 'little'), b''
    while len(text) < size:
        text += client.recv(size - len(text))
    if (pid := os.fork()) == 0:
        client.close()
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
            os.close(stream)
        _become(*json.loads(text))
    for stream in streams:
        os.close(stream)
    client.sendall(pid.to_bytes(4, 'little'))
    ended = os.pidfd_open(pid)
    if client in select.select([client, ended], [], [])[0]:  # which has been killed
        os.kill(pid, signal.SIGKILL)
        return
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    client.sendall(code.to_bytes(4, 'little', signed=True))


def _become(words: list[str], folder: str, environment: dict[str, str]) -> None:
    """Run a command as its program would, and end."""
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    sys.stdin, sys.stdout, sys.stderr = os.fdopen(0), os.fdopen(1, 'w'), os.fdopen(2, 'w', 1)
    code: Any = 1
    try:
        name = Path(words[0]).name
        sys.argv = words[1:] if name == 'python' else [str(BIN / name), *words[1:]]
        paths = environment.get('PYTHONPATH', '').split(os.pathsep)
        sys.path[:0] = [str(Path(sys.argv[0]).parent), *filter(None, paths)]
        if sys.argv[0] == '-m':
            del sys.argv[0]
            runpy.run_module(sys.argv[0], run_name='__main__', alter_sys=True)
        else:
            runpy.run_path(sys.argv[0], run_name='__main__')
        code = 0
    except SystemExit as end:
        code = end.code
    except BaseException:
        traceback.print_exc()
    if isinstance(code, str):
        print(code, file=sys.stderr)
        code = 1
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code or 0)
