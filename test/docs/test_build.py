"""The manual builds without warnings and calls no other host."""

from pathlib import Path
import re
import runpy
import shutil
import subprocess
import sys

from manual_blocks import DOCS, ROOT, WRITTEN
import sphinx

LINKED = re.compile(r'!\[[^]]*\]\(http|<img[^>]*src="http|<(?:script|link|img)[^>]*="(?:http|//)')


def build(builder: str, source: Path, *words: str) -> Path:
    """Build pages without warnings; return their folder."""
    out = source.parent / builder
    command = [sys.executable, '-m', sphinx.__name__, '-q', '-W', '--keep-going', '-b', builder]
    done = subprocess.run(
        [*command, *words, str(source), str(out)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-4000:]
    return out


def test_the_manual_builds_without_warnings(tmp_path: Path) -> None:
    source = tmp_path / 'docs'  # a copy, as the build writes pages of modules among its sources
    shutil.copytree(DOCS, source, ignore=shutil.ignore_patterns('api', '_build'))
    for path in [*ROOT.glob('*.md'), *ROOT.glob('*.rst'), ROOT / 'package.xml']:
        shutil.copy(path, tmp_path)
    extensions = set(runpy.run_path(str(source / 'conf.py'))['extensions'])
    quick = ','.join(extensions - {'sphinx.ext.viewcode'})  # which copies the code
    build('dummy', source, '-D', f'extensions={quick}')


def test_pages_call_no_other_host(tmp_path: Path) -> None:
    source = tmp_path / 'docs'
    source.mkdir()
    for path in (DOCS / 'conf.py', ROOT / 'package.xml'):
        shutil.copy(path, source if path.suffix == '.py' else tmp_path)
    shutil.copytree(DOCS / '_static', source / '_static')
    (source / 'index.md').write_text('# A page\n\n```bash\nls\n```\n')
    texts = {
        path: path.read_text(encoding='utf-8') for path in WRITTEN if path.is_relative_to(DOCS)
    }
    pages = build('html', source).glob('*.html')
    texts |= {page: page.read_text(encoding='utf-8') for page in pages}
    assert any(path.suffix == '.html' for path in texts)
    for path, text in texts.items():
        assert not LINKED.findall(text), path
