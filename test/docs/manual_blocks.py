"""Blocks of code in Markdown pages, and a script that runs those of a page in their order."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
import re
import shlex

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / 'docs'
README = ROOT / 'README.md'
DATA = ('results', 'checkpoints')  # written by commands, not by hand
WRITTEN = [
    README,
    ROOT / 'CONTRIBUTING.md',
    *sorted(p for p in DOCS.rglob('*.md') if p.parent.name not in (*DATA, 'reference', '_build')),
]
RUN = [
    README,
    DOCS / 'quickstart.md',
    *sorted((DOCS / 'tutorials').glob('*.md')),
    DOCS / 'how_to' / 'without_ros.md',
    DOCS / 'how_to' / 'stable_baselines3.md',
]
# what a test cannot run: other tests check the words of these lines
CHECKED = (
    'ros2', 'make', 'pip', 'git', 'colcon', 'rosdep', 'source', 'torchrun', 'sudo', 'python3',
    'pre-commit', 'pytest', 'ruff',
)  # fmt: skip
BLOCK = re.compile(r'^(?:<!-- test: (.*?) -->\n)?```(bash|python)\n(.*?)^```', re.M | re.S)


@dataclass(frozen=True)
class Block:
    """
    A block of code and what a test has to know of it.

    The comment before it, `<!-- test: ... -->`, is `skip WHY`, `file NAME` (save it instead of
    running it), `expect CODE`, or `with A => B; C => D` (texts that make it short).
    """

    kind: str
    text: str
    note: str = ''

    @property
    def lines(self) -> list[str]:
        """Return the commands, continued lines joined."""
        whole = re.sub(r'\\\n *', ' ', self.text)
        return [line for line in whole.splitlines() if line.strip() and line[0] != '#']

    @property
    def runs(self) -> bool:
        """Return whether a test can run the block."""
        if self.note.startswith('skip') or 'shepherd demo' in self.text:
            return False
        words = [shlex.split(line, comments=True)[:1] for line in self.lines]
        return self.kind == 'python' or not any(w and w[0] in CHECKED for w in words)

    @property
    def short(self) -> str:
        """Return the text that a test runs."""
        text = self.text
        if self.note.startswith('with '):
            for change in self.note.removeprefix('with ').split(';'):
                old, _, new = (part.strip() for part in change.partition('=>'))
                assert old in text, f'{old!r} is not in the block that it shortens'
                text = text.replace(old, new)
        return text


def blocks(page: Path) -> list[Block]:
    """Return the blocks of a page."""
    found = BLOCK.findall(page.read_text(encoding='utf-8'))
    return [Block(kind, text, ' '.join(note.split())) for note, kind, text in found]


def script(page: Path) -> str:
    """Return a shell script that runs the blocks of a page in their order."""
    parts = ['set -e']
    for number, block in enumerate(blocks(page)):
        if not block.runs:
            continue
        name = block.note.removeprefix('file ') if block.note.startswith('file ') else ''
        if block.kind == 'bash':
            code = block.note.removeprefix('expect ') if block.note.startswith('expect') else '0'
            if code != '0':
                parts.append(f'{block.short.strip()} && exit 99 || test $? = {code}')
            else:
                parts.append(block.short.strip())
        else:
            saved = name or f'block_{number}.py'
            parts.append(f"cat > {saved} <<'END_OF_BLOCK'\n{block.short}END_OF_BLOCK")
            if not name:
                parts.append(f'PYTHONPATH=$PWD:$PYTHONPATH python {saved}')
    return '\n'.join(parts) + '\n'
