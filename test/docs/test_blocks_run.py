"""The commands and programs of README and of the tutorials run, from an empty folder."""

import os
from pathlib import Path
import subprocess

from manual_blocks import blocks, ROOT, RUN, script
import pytest

pytestmark = pytest.mark.system
PAGES = [page for page in RUN if any(block.runs for block in blocks(page))]


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.stem)
def test_a_page_runs_from_top_to_bottom(page: Path, commands: Path, tmp_path: Path) -> None:
    environment = os.environ | {
        'PATH': f'{commands}:{os.environ["PATH"]}',
        'PYTHONPATH': str(ROOT),
        'OMP_NUM_THREADS': '1',
    }
    environment.pop('SHEPHERD_ROS_PLUGINS', None)
    done = subprocess.run(
        ['bash', '-x', '-c', script(page)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, f'{done.stdout[-2000:]}\n{done.stderr[-4000:]}'
