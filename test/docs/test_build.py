"""The manual builds without warnings and calls no other host."""

from pathlib import Path
import shutil
import subprocess
import sys

from manual_blocks import DOCS, ROOT
import sphinx


def test_the_manual_builds_without_warnings(tmp_path: Path) -> None:
    source = tmp_path / 'docs'  # a copy, as the build writes pages of modules among its sources
    shutil.copytree(DOCS, source, ignore=shutil.ignore_patterns('api', '_build'))
    for path in [*ROOT.glob('*.md'), *ROOT.glob('*.rst'), ROOT / 'package.xml']:
        shutil.copy(path, tmp_path)
    words = ['-m', sphinx.__name__, '-q', '-W', '--keep-going', '-d', str(tmp_path / 'cache')]
    done = subprocess.run(
        [sys.executable, *words, str(source), str(tmp_path / 'manual')],
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
