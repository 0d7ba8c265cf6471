"""Laws compiled by numba before tests need them: once for all workers."""

from __future__ import annotations

import fcntl
from functools import cache
import os
from pathlib import Path
import subprocess
import sys
import tempfile

ROOT = Path(__file__).resolve().parents[1]
LOCK = 'SHEPHERD_ROS_TEST_LAWS'  # the file that is locked while they are compiled


@cache
def compile_laws() -> None:
    """Let numba compile what nodes compute, which takes a while the first time on a machine."""
    from shepherd_ros.experiments.methods import make_method
    from shepherd_ros.experiments.setting import env_config, Setting
    from shepherd_ros.sim.env import ShepherdEnv
    from shepherd_ros.sim.flocking import FLOCK_MODELS

    for flock in FLOCK_MODELS:
        setting = Setting(flock=flock)
        env = ShepherdEnv(env_config(setting), 1)
        env.reset()
        for name in ('strombom', 'pierson', 'policy:imitation'):
            law = make_method(name, setting)
            env.step(law.act(env.perceived, law.begin(env.perceived))[0])


def compile_beside() -> None:
    """Start to compile in another process, if nothing is compiled here; wait_for_laws() waits."""
    if any((ROOT / 'shepherd_ros').rglob('*.nbi')):
        return
    with tempfile.NamedTemporaryFile(prefix='laws', delete=False) as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # until the process ends, which has it, too
        environment = os.environ | {'PYTHONPATH': str(ROOT)}
        subprocess.Popen([sys.executable, __file__], pass_fds=[lock.fileno()], env=environment)
        os.environ[LOCK] = lock.name


def wait_for_laws() -> None:
    """Return once nobody compiles any more."""
    if path := os.environ.get(LOCK):
        with Path(path).open() as lock:
            fcntl.flock(lock, fcntl.LOCK_SH)


if __name__ == '__main__':
    compile_laws()
