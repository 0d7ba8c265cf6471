"""Files that pages load: those beside this one, and the library that draws curves."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

PLOTLY_FILE = 'plotly.min.js'
MEDIA_TYPES = {
    '.css': 'text/css; charset=utf-8',
    '.html': 'text/html; charset=utf-8',
    '.js': 'text/javascript; charset=utf-8',
}


def asset(name: str) -> Path | None:
    """Return the file of a page with a name such as console.css, None if there is none."""
    if name == PLOTLY_FILE:
        spec = find_spec('plotly')  # importing it takes a second
        origin = spec.origin if spec is not None else None
        return None if origin is None else Path(origin).parent / 'package_data' / name
    files = Path(__file__).parent.iterdir()
    return next((f for f in files if f.name == name and f.suffix in MEDIA_TYPES), None)
