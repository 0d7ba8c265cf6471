"""The commit of the running code, for records of results."""

from __future__ import annotations

from pathlib import Path
import subprocess


def commit() -> str:
    """Return the commit of the checkout that runs, + if it was changed; empty without git."""
    here = Path(__file__).parent
    words = ['git', 'describe', '--always', '--dirty=+', '--exclude=*']
    try:
        done = subprocess.run(words, cwd=here, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ''
    return done.stdout.strip()
