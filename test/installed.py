"""Packages that tests need and that are not installed, found without importing the tests."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
import os
from pathlib import Path
import re
import sys

HERE = Path(__file__).resolve().parent
PACKAGE = 'shepherd_ros'
# what runs programs of ours, which need all that the package requires
RUNS = re.compile(r'\b(subprocess|runpy|commands|generate|sys\.executable)\b')
MODULES = {'pillow': 'PIL', 'pyyaml': 'yaml'}  # of distributions with another name
# at the start of a line, as those of functions and for type checkers are not
IMPORTS = re.compile(r'^(?:from (\S+) import (\([^)]*\)|.*)|import ([\w.]+))', re.MULTILINE)


@cache
def _modules(path: Path) -> list[str]:
    """Return the names of what importing a file imports; one may be a thing inside a module."""
    text, found = path.read_text(encoding='utf-8'), []
    for module, names, plain in IMPORTS.findall(text):
        things = re.findall(r'^ *(\w+)', names.strip('()').replace(',', '\n'), re.MULTILINE)
        found += [plain] if plain else [f'{module}.{thing}' for thing in things]
    if 'iter_modules(__path__)' in text:  # the package imports all its modules
        folder = '.'.join(path.parent.relative_to(HERE.parent).parts)
        found += [f'{folder}.{other.stem}' for other in path.parent.glob('[!_]*.py')]
    return found


@cache
def _own_files(name: str, beside: Path) -> list[Path] | None:
    """Return the files of this repository that importing a module runs; None if it is not ours."""
    first, *parts = name.split('.')
    roots = [HERE.parent] if first == PACKAGE else [HERE, beside]
    for root in roots:
        place, files = root / first, []
        if not place.is_dir() and not place.with_suffix('.py').is_file():
            continue
        for part in [*parts, '']:
            options = [place.with_suffix('.py'), place / '__init__.py']
            files += [path for path in options if path.is_file()]
            place /= part
        return files
    return None


@cache
def _edges(path: Path) -> tuple[set[str], list[Path]]:
    """Return packages of others and own files that a file names in its imports."""
    files = {name: _own_files(name, path.parent) for name in _modules(path)}
    others = {name.partition('.')[0] for name, own in files.items() if own is None}
    return others, [*dict.fromkeys(file for own in files.values() for file in own or ())]


def executables() -> Path:
    """Return the folder of the executables: beside this Python, or in a workspace of colcon."""
    prefixes = filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep))
    own = Path(sys.executable).parent
    folders = (own, *(Path(prefix, 'lib', PACKAGE) for prefix in prefixes))
    return next((folder for folder in folders if (folder / 'shepherd').is_file()), own)


@cache
def required() -> frozenset[str]:
    """Return the packages that the package requires."""
    setup = (HERE.parent / 'setup.py').read_text(encoding='utf-8')
    listed = setup.partition('install_requires=[')[2].partition('],\n')[0]
    names = re.findall(r"'([\w-]+)", listed)
    return frozenset(MODULES.get(name, name) for name in names)


@cache
def needed(path: Path) -> frozenset[str]:
    """Return the packages of others that a file of tests imports, also through our own files."""
    runs_programs = RUNS.search(path.read_text(encoding='utf-8'))
    found = set(required()) if runs_programs else set[str]()
    seen, waiting = {path}, [path]
    while waiting:
        others, own = _edges(waiting.pop())
        found |= others
        waiting += [file for file in own if file not in seen]
        seen.update(own)
    return frozenset(found)


def missing_packages(path: Path) -> list[str]:
    """Return the packages that a file of tests needs and that are not installed."""
    return sorted(name for name in needed(path) if find_spec(name) is None)
