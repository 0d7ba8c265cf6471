"""Files beside this one that a browser loads."""

from __future__ import annotations

from pathlib import Path

MEDIA_TYPES = {
    '.css': 'text/css; charset=utf-8',
    '.html': 'text/html; charset=utf-8',
    '.js': 'text/javascript; charset=utf-8',
}


def asset(name: str) -> Path | None:
    """Return the file of a page with a name such as console.css, None if there is none."""
    files = Path(__file__).parent.iterdir()
    return next((f for f in files if f.name == name and f.suffix in MEDIA_TYPES), None)
