"""Look of pages: the colours of pictures as variables of CSS, by day and by night."""

from __future__ import annotations

from pathlib import Path
from string import Template

from shepherd_ros.view.scene import (
    GOAL_COLOR,
    GOAL_FILL,
    GRID,
    INK,
    SHEEP_COLOR,
    SHEPHERD_COLORS,
)

DRAWING = ('canvas.js', 'ground.js', 'plane.js', 'curves.js')  # of every page, in this order
_NIGHT_SHEPHERDS = ('#F0803C', '#DE7FBD', '#F0B429', '#A98BF0', '#C99C6C')
_COLORS = {  # by day and by night
    'ground': ('#FFFFFF', '#14181B'),
    'panel': ('#F6F7F8', '#1B2024'),
    'raised': ('#FFFFFF', '#262C31'),
    'ink': (INK, '#E8ECEF'),
    'faint': ('#626B72', '#9DA8B0'),
    'line': ('#DDE1E4', '#363E45'),
    'grid': (GRID, '#20262B'),
    'frame': ('#C9CFD3', '#3A434A'),
    'accent': ('#0072B2', '#56B4E9'),
    'on-accent': ('#FFFFFF', '#0B1114'),
    'focus': ('#C77700', '#F0B429'),
    'good': ('#00795A', '#2CC99B'),
    'warn': ('#8A5A00', '#F0B429'),
    'bad': ('#B8400E', '#FF8A5C'),
    'sheep': (SHEEP_COLOR, '#56B4E9'),
    'other': ('#A7B4BD', '#5F6F7A'),
    'goal': (GOAL_COLOR, '#2CC99B'),
    'goal-fill': (GOAL_FILL, '#12372C'),
    'on-shepherd': ('#FFFFFF', '#14181B'),
    **{
        f'shepherd-{index}': pair
        for index, pair in enumerate(zip(SHEPHERD_COLORS, _NIGHT_SHEPHERDS, strict=True))
    },
}


def beside(name: str) -> str:
    """Return the text of a file beside this one."""
    return Path(__file__).with_name(name).read_text(encoding='utf-8')


def palette() -> str:
    """Return the colours as CSS: variables of the day, and those of the night where it is dark."""
    day, night = (
        ''.join(f' --{name}: {pair[index]};' for name, pair in _COLORS.items())
        for index in range(2)
    )
    return f':root {{{day} }}\n@media (prefers-color-scheme: dark) {{ :root {{{night} }} }}'


def style() -> str:
    """Return the CSS that all pages share."""
    return Template(beside('look.css')).substitute(palette=palette())


def drawing() -> str:
    """Return the JavaScript that draws plane and curves, of all pages."""
    return '\n'.join(map(beside, DRAWING))
