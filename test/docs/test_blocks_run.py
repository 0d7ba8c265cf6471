"""The commands and programs of README and of the tutorials run, from an empty folder."""

import os
from pathlib import Path
import subprocess
import sys

from manual_blocks import blocks, ROOT, RUN, script
import pytest

SHEPHERD = f"""#!{sys.executable}
import sys
from shepherd_ros.cli import main
if __name__ == '__main__':
    sys.exit(main())
"""
PROGRAMS = {'shepherd': SHEPHERD, 'python': f'#!/bin/sh\nexec {sys.executable} "$@"\n'}


@pytest.mark.timeout(600)
@pytest.mark.parametrize('page', RUN, ids=lambda page: page.stem)
def test_a_page_runs_from_top_to_bottom(page: Path, tmp_path: Path) -> None:
    if not any(block.runs for block in blocks(page)):
        pytest.skip('nothing on this page runs without ROS 2')
    place, commands = tmp_path / 'empty', tmp_path / 'bin'
    for folder in (place, commands):
        folder.mkdir()
    for name, text in PROGRAMS.items():
        (commands / name).write_text(text)
        (commands / name).chmod(0o755)
    environment = os.environ | {
        'PATH': f'{commands}:{os.environ["PATH"]}',
        'PYTHONPATH': str(ROOT),
        'OMP_NUM_THREADS': '1',
    }
    environment.pop('SHEPHERD_ROS_PLUGINS', None)
    done = subprocess.run(
        ['bash', '-x', '-c', script(page)],
        cwd=place,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, f'{done.stdout[-2000:]}\n{done.stderr[-4000:]}'
