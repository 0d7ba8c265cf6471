"""Look of pages: files beside this one that all pages have in common."""

from __future__ import annotations

from pathlib import Path

STYLES = ('palette.css', 'look.css')
DRAWING = ('canvas.js', 'ground.js', 'tip.js', 'plane.js', 'curves.js')  # in this order


def beside(*names: str) -> str:
    """Return the joined text of files beside this one."""
    here = Path(__file__)
    return '\n'.join(here.with_name(name).read_text(encoding='utf-8') for name in names)
