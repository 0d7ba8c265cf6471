"""Checks of the machine: room on the disk, folders that are written."""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import shutil
import tempfile

from shepherd_ros.doctor.diagnosis import Diagnosis, error, ok, warning

LITTLE_DISK = 2e9  # [bytes] below which a day of recording may not fit
NO_DISK = 1e8  # [bytes] below which not even a few bags fit
SHARED_MEMORY = Path('/dev/shm')
LITTLE_MEMORY = 16e6  # [bytes] of shared memory that a stack of processes needs at least


def writable(folder: Path) -> str:
    """Return why a folder, made where it is not there, cannot be written; '' if it can."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder):
            return ''
    except OSError as fault:
        return fault.strerror or type(fault).__name__


def check_disk() -> Iterator[Diagnosis]:
    """Yield whether bags and runs fit into the working folder."""
    here = Path.cwd()
    if reason := writable(here):
        yield error('disk', f'{here} cannot be written ({reason})', 'work in a folder of yours')
        return
    free = shutil.disk_usage(here).free
    text, fix = f'{free / 1e9:.1f} GB free in {here}', 'remove old bags and runs'
    if free < NO_DISK:
        yield error('disk', text, fix)
    elif free < LITTLE_DISK:
        yield warning('disk', text, fix)
    else:
        yield ok('disk', text)


def log_folder() -> Path:
    """Return the folder of the logs of ROS 2, as rcl_logging finds it."""
    home = os.environ.get('ROS_HOME') or '~/.ros'
    return Path(os.environ.get('ROS_LOG_DIR') or f'{home}/log').expanduser()


def check_logs() -> Iterator[Diagnosis]:
    """Yield whether nodes can write their logs, without which they do not start."""
    folder = log_folder()
    if reason := writable(folder):
        fix = 'export ROS_LOG_DIR to a folder of yours'
        yield error('logs', f'{folder} cannot be written ({reason})', fix)
    else:
        yield ok('logs', str(folder))


def check_shared_memory() -> Iterator[Diagnosis]:
    """Yield whether DDS has the shared memory that it takes on one machine."""
    if os.environ.get('FASTDDS_BUILTIN_TRANSPORTS', 'DEFAULT') not in ('DEFAULT', 'SHM'):
        transports = os.environ['FASTDDS_BUILTIN_TRANSPORTS']
        yield ok('shared memory', f'not used: FASTDDS_BUILTIN_TRANSPORTS is {transports}')
        return
    fix = 'export FASTDDS_BUILTIN_TRANSPORTS=UDPv4, or give a container --ipc=host'
    try:
        free = shutil.disk_usage(SHARED_MEMORY).free
    except OSError as fault:
        yield warning('shared memory', f'{SHARED_MEMORY}: {fault.strerror}', fix)
        return
    text = f'{free / 1e6:.0f} MB free in {SHARED_MEMORY}'
    yield (
        ok('shared memory', text) if free > LITTLE_MEMORY else warning('shared memory', text, fix)
    )
