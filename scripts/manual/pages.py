"""All pages of the reference by file name."""

from __future__ import annotations

import ast
from pathlib import Path

import shepherd_ros

from manual.commands import commands
from manual.console import console
from manual.data import bags, checkpoints, dataset, metric_names, presets
from manual.errors import errors
from manual.graph import graph
from manual.tables import page
from manual.wire import parameters, services, topics

SOURCE = Path(shepherd_ros.__file__).parent
ROOMS = {
    'sim': 'Simulation',
    'sim/flocking': 'Flock models',
    'controllers': 'Controllers',
    'policy': 'Policies and checkpoints',
    'learning': 'Training',
    'integrations': 'Gymnasium, PettingZoo, Stable-Baselines3',
    'recordings': 'Episodes in bags',
    'rosbag2': 'Files of bags',
    'wire': 'Topics and messages',
    'datasets': 'Data sets',
    'experiments': 'Experiments',
    'view': 'Pictures',
}


def public(path: Path) -> bool:
    """Return whether a module is for users: not private, no compiled form of another one."""
    stem = path.stem
    return not (stem.startswith('_') or stem.endswith('_compiled') or stem == 'compiled')


def api() -> str:
    """Return the page from which autosummary makes the pages of modules."""
    parts = []
    for room, title in ROOMS.items():
        folder = SOURCE / room
        names = sorted(path.stem for path in folder.glob('*.py') if public(path))
        dotted = room.replace('/', '.')
        listed = '\n'.join(f'   shepherd_ros.{dotted}.{name}' for name in names)
        about = ast.get_docstring(ast.parse((folder / '__init__.py').read_text(encoding='utf-8')))
        first = (about or '').split('\n\n')[0]
        parts += [
            f'## {title}',
            ' '.join(first.split()),
            f'```{{eval-rst}}\n.. autosummary::\n   :toctree: api\n\n{listed}\n```',
        ]
    core = '```{eval-rst}\n.. autosummary::\n   :toctree: api\n\n   shepherd_ros.config\n'
    intro = (
        'Docstrings give shapes and units: `(..., N, 2) m` is any leading axes, N sheep, x and y '
        'in metres. Axis letters: `B` worlds, `N` sheep, `H` shepherds, `R` rays, `C` channels, '
        '`K` frames, `T` steps. Names without a leading underscore are public; before version '
        '1.0 they may change with each minor version.'
    )
    return page('Python API', intro, *parts, '## Ground', core + '   shepherd_ros.registry\n```')


def pages() -> dict[str, str]:
    """Return path in docs/ -> text of every generated file."""
    return {
        '_static/graph.svg': graph(),
        **{f'reference/{name}': text for name, text in reference().items()},
    }


def reference() -> dict[str, str]:
    """Return file name -> text of every page of the reference."""
    return {
        'topics.md': topics(),
        'parameters.md': parameters(),
        'services.md': services(),
        'commands.md': commands(),
        'console.md': console(),
        'bags.md': bags(),
        'dataset.md': dataset(),
        'checkpoints.md': checkpoints(),
        'presets.md': presets(),
        'metrics.md': metric_names(),
        'errors.md': errors(),
        'api.md': api(),
    }
