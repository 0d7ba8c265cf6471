"""The manual builds without warnings and calls no other host."""

from importlib.util import find_spec
from pathlib import Path
import subprocess
import sys

from manual_blocks import DOCS
import pytest


@pytest.mark.timeout(600)
@pytest.mark.skipif(find_spec('sphinx') is None, reason='make docs installs Sphinx')
def test_the_manual_builds_without_warnings(tmp_path: Path) -> None:
    words = ['-m', 'sphinx', '-q', '-W', '--keep-going', '-d', str(tmp_path / 'cache')]
    done = subprocess.run(
        [sys.executable, *words, str(DOCS), str(tmp_path / 'manual')],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    called = [
        f'{path.name}: {line.strip()[:120]}'
        for path in (tmp_path / 'manual').rglob('*.html')
        for line in path.read_text(encoding='utf-8').splitlines()
        if ('<script' in line or '<link' in line or '<img' in line) and '//' in line
        and 'rel="author"' not in line and 'http' in line.split('>')[0]
    ]  # fmt: skip
    assert not called, 'pages call no other host'
