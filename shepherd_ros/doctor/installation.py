"""Checks of what is installed: Python, packages, numbers, pictures, plug-ins, checkpoints."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version
import os
from pathlib import Path
import platform
import re
import subprocess
import sys

from shepherd_ros import __version__
from shepherd_ros.config import ConfigError
from shepherd_ros.doctor.diagnosis import Diagnosis, error, ok, warning

PYTHONS = ((3, 11), (3, 12))  # oldest and newest that are tried
_SHOWN = ('torch', 'numpy', 'pyarrow', 'mcap', 'tyro')  # packages whose versions are told
CPU_QUOTA = Path('/sys/fs/cgroup/cpu.max')  # of a container
_COMMANDS = ('shepherd', 'flock_sim', 'lidar', 'metrics', 'controller', 'policy', 'recorder')


def check_python() -> Iterator[Diagnosis]:
    """Yield whether this Python is one that is tried."""
    text = f'{platform.python_version()} at {sys.executable}'
    (old, new), now = PYTHONS, sys.version_info[:2]
    supported = f'{old[0]}.{old[1]} to {new[0]}.{new[1]}'
    if now < old:
        yield error('python', f'{text}: too old', f'use Python {supported}; 3.12 is that of Jazzy')
    elif now > new:
        yield warning('python', f'{text}: not tried', f'use Python {supported} if something fails')
    else:
        yield ok('python', text)


def check_packages() -> Iterator[Diagnosis]:
    """Yield whether every required package is installed, with the versions of some."""
    try:
        needed = [r for r in requires('shepherd_ros') or [] if 'extra ==' not in r]
        installed = version('shepherd_ros')
    except PackageNotFoundError:
        yield warning(
            'packages', 'shepherd_ros is not installed, only found', 'pip install --editable .'
        )
        return
    names = [re.split(r'[^\w.-]', requirement)[0] for requirement in needed]
    missing = [name for name in names if _version(name) is None]
    if missing:
        fix = f'pip install {" ".join(missing)}'
        yield error('packages', f'not installed: {", ".join(missing)}', fix)
    elif installed != __version__:
        text = f'{__version__} runs, {installed} is installed'
        yield warning('packages', text, 'pip install --editable . again')
    else:
        versions = ', '.join(f'{name} {_version(name)}' for name in _SHOWN)
        yield ok(
            'packages', f'shepherd_ros {__version__}, all {len(names)} that it needs: {versions}'
        )


def _version(name: str) -> str | None:
    """Return the version of an installed package, None if it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def check_commands() -> Iterator[Diagnosis]:
    """Yield whether the executables are found, as demo and replay start them."""
    from shepherd_ros.resources import executable_path

    missing = [name for name in _COMMANDS if executable_path(name) is None]
    if missing:
        text = f'neither beside this Python nor on PATH: {", ".join(missing)}'
        yield error('executables', text, 'pip install --editable ., or source the workspace')
    else:
        path = executable_path('flock_sim')
        yield ok('executables', f'in {path.parent if path else ""}')


def cores() -> float:
    """Return how many cores this process may use, as affinity and the container's quota say."""
    allowed = float(len(os.sched_getaffinity(0)))
    try:
        quota, period = CPU_QUOTA.read_text(encoding='utf-8').split()
        return min(allowed, float(quota) / float(period))
    except (OSError, ValueError, ZeroDivisionError):  # no container, or max
        return allowed


def check_torch() -> Iterator[Diagnosis]:
    """Yield whether torch counts, and whether its threads fit the cores."""
    import torch

    threads, allowed = torch.get_num_threads(), cores()
    gpu = torch.cuda.get_device_name(0) if torch.cuda.is_available() else 'no GPU'
    text = f'{torch.__version__}, {gpu}, threads: {threads}, cores: {allowed:g}'
    if float(torch.ones(3).sum()) != 3.0:
        yield error('torch', f'{text}: 1 + 1 + 1 is not 3', 'pip install --force-reinstall torch')
    elif threads > max(1, allowed):
        fix = f'export OMP_NUM_THREADS={max(1, int(allowed))}'
        yield warning('torch', f'{text}: they wait for each other', fix)
    else:
        yield ok('torch', text)


def check_numba() -> Iterator[Diagnosis]:
    """Yield whether the compiled laws are used."""
    from shepherd_ros.sim.compiled import HAS_NUMBA, start_numba

    if os.environ.get('SHEPHERD_ROS_PLAIN') == '1':
        yield warning(
            'numba', 'not used: SHEPHERD_ROS_PLAIN is 1, and laws run slowly', 'unset it'
        )
    elif not HAS_NUMBA:
        yield warning('numba', 'not installed: laws run slowly', 'pip install numba')
    else:
        try:
            start_numba()
            yield ok('numba', f'{_version("numba")}, compiles and keeps laws on disk')
        except Exception as fault:  # whatever a compiler says
            text = ' '.join(str(fault).split())[:200]
            fix = 'pip install --upgrade numba, or export NUMBA_CACHE_DIR to a folder of yours'
            yield error('numba', f'{_version("numba")} does not compile ({text})', fix)


def check_ffmpeg() -> Iterator[Diagnosis]:
    """Yield whether videos can be written."""
    from shepherd_ros.view.video import ffmpeg_version

    try:
        yield ok('ffmpeg', ffmpeg_version())
    except (OSError, RuntimeError, subprocess.SubprocessError, ImportError) as fault:
        text = f'no videos, only GIF ({" ".join(str(fault).split())[:200]})'
        yield warning('ffmpeg', text, "pip install 'imageio[ffmpeg]'")


def check_plugins() -> Iterator[Diagnosis]:
    """Yield whether plug-ins can be imported."""
    from shepherd_ros.registry import load_plugins, plugin_names

    names = plugin_names()
    try:
        load_plugins()
        yield ok('plug-ins', ', '.join(names) or 'none')
    except ConfigError as fault:
        fix = 'mend or uninstall it, or take it out of SHEPHERD_ROS_PLUGINS'
        yield error('plug-ins', str(fault), fix)


def check_checkpoints() -> Iterator[Diagnosis]:
    """Yield whether the shipped checkpoints can be read."""
    from shepherd_ros.policy.checkpoint import load_policy, shipped_checkpoints

    names, faults = shipped_checkpoints(), []
    for name in names:
        try:
            load_policy(name)
        except (ConfigError, OSError) as fault:
            faults.append(f'{name}: {fault}')
    if faults:
        yield error('checkpoints', '; '.join(faults), 'install the package again')
    elif not names:
        yield warning('checkpoints', 'none is shipped', 'install the package again')
    else:
        yield ok('checkpoints', ', '.join(names))
