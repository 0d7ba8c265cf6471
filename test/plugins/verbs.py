"""Verbs of the command line in a process that has plug-ins."""

from __future__ import annotations

import json
import os
from pathlib import Path
import subprocess
import sys

from shepherd_ros.cli import main


def run(python: Path, plugins: str, *commands: str, **variables: str) -> list[str]:
    """Return what verbs say, one after another; those that begin with ! have to be refused."""
    words = json.dumps([command.removeprefix('!') for command in commands])
    done = subprocess.run(
        [python, __file__, words],
        env=os.environ | {'SHEPHERD_ROS_PLUGINS': plugins} | variables,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert done.returncode == 0, done.stdout
    *parts, _ = done.stdout.split('\0')
    output, codes = parts[::2], parts[1::2]
    for command, text, code in zip(commands, output, codes, strict=True):
        assert code == ('2' if command.startswith('!') else '0'), f'{command}: {text}'
    return output


if __name__ == '__main__':
    for words in json.loads(sys.argv[1]):
        print(f'\0{main(words.split())}\0', flush=True)
