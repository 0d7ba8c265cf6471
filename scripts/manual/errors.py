"""The page of error messages, read from the source."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import shepherd_ros

from manual.tables import page

KINDS = (
    'ConfigError',
    'UserError',
    'BagError',
    'MissingError',
    'DamageError',
    'UnknownEntryError',
)
SOURCE = Path(shepherd_ros.__file__).parent
ROOMS = {
    'cli': 'shepherd: what was given on the command line',
    'config.py': 'Values of options and parameters',
    'controllers': 'Controllers',
    'datasets': 'Data sets',
    'experiments': 'Experiments',
    'integrations': 'Environments for other libraries',
    'learning': 'Training',
    'nodes': 'Nodes',
    'paper': 'Figures and report',
    'policy': 'Checkpoints and policies',
    'recordings': 'Episodes in bags',
    'registry.py': 'Plug-ins',
    'ros': 'Nodes: parameters and messages',
    'rosbag2': 'Files of bags',
    'sim': 'Worlds',
    'view': 'Pictures',
    'wire': 'Topics and episodes',
}


def template(node: ast.expr) -> str:
    """Return the text of a string, with {name} where a value is put in."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return ''.join(template(value) for value in node.values)
    if isinstance(node, ast.FormattedValue):
        return '{' + ast.unparse(node.value).split('(')[0].split('[')[0].split('.')[-1] + '}'
    if isinstance(node, ast.BinOp):
        return template(node.left) + template(node.right)
    return '{' + ast.unparse(node).split('.')[-1] + '}'


def messages(path: Path) -> Iterator[str]:
    """Yield the messages of the errors that a file raises."""
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in KINDS and node.args:
            first, *more = [template(argument) for argument in node.args]
            if ' ' in ''.join([first, *more]):
                text = f'{first}: {"; ".join(more)}' if more else first
                yield ' '.join(text.split())


def errors() -> str:
    """Return the page of the error messages by room."""
    parts = []
    for room, title in ROOMS.items():
        place = SOURCE / room
        files = [place] if place.is_file() else sorted(place.rglob('*.py'))
        texts = dict.fromkeys(text for file in files for text in messages(file))
        if texts:
            parts.append(f'## {title}')
            parts.append('\n'.join(f'- ``{text}``' for text in texts))
    intro = (
        'Every message names the value, what is expected, and what to do. `{name}` stands for a '
        'value. Symptoms and their causes are in [](../troubleshooting.md).'
    )
    return page('Error messages', intro, *parts)
