"""The rooms of CONTRIBUTING.md: floors, who may import what, no circles, short files."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from importlib import import_module
from itertools import groupby, pairwise
from pathlib import Path
from pkgutil import iter_modules, walk_packages
import re
import shutil
import subprocess
import sys
from types import ModuleType

import pytest
import shepherd_ros
import tomllib

grimp = pytest.importorskip('grimp')
pytest.importorskip('importlinter')

ROOT = Path(__file__).resolve().parents[1]
SHORT = ('shepherd_ros', 'scripts', 'benchmarks', 'launch')  # folders whose files are short
LONGEST_FILE, LONGEST_FUNCTION, LONGEST_SCRIPT = 250, 50, 39  # lines
PROJECT = tomllib.loads((ROOT / 'pyproject.toml').read_text(encoding='utf-8'))
CONTRACTS = PROJECT['tool']['importlinter']['contracts']
LINT = 'import sys, importlinter.cli as cli; sys.exit(cli.lint_imports_command())'


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    """Return what import-linter says of the code in a folder."""
    command = [sys.executable, '-c', LINT, '--no-cache', '--no-logo']
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


@pytest.fixture(scope='module')
def graph() -> grimp.ImportGraph:
    """Return who imports whom, packages of others included."""
    return grimp.build_graph('shepherd_ros', include_external_packages=True, cache_dir=None)


FORBIDDEN = (
    ('sim/spawn.py', 'import shepherd_ros.policy.network', 'floors'),
    ('new_room.py', '', 'floors'),
    ('sim/transition.py', 'import shepherd_ros.sim.env', 'circles'),
    ('view/track.py', 'import torch', 'without-torch'),
    ('view/scene.py', 'from shepherd_ros.sim.state import WorldState', 'without-torch'),
    ('wire/decode.py', 'import shepherd_ros.sim.state', 'without-torch'),
    ('rosbag2/reader.py', 'import torch', 'without-torch'),
    ('recordings/info.py', 'import rclpy', 'ros'),
    ('sim/world.py', 'from geometry_msgs.msg import Point', 'ros'),
    ('nodes/policy_node.py', 'import shepherd_ros.rosbag2.reader', 'bags'),
    ('learning/ppo.py', 'def late():\n    import mcap', 'mcap'),
)


def test_forbidden_imports_are_found(tmp_path: Path) -> None:
    ignored = shutil.ignore_patterns('__pycache__')
    shutil.copytree(ROOT / 'shepherd_ros', tmp_path / 'shepherd_ros', ignore=ignored)
    shutil.copy(ROOT / 'pyproject.toml', tmp_path)
    for file, line, _ in FORBIDDEN:
        with (tmp_path / 'shepherd_ros' / file).open('a', encoding='utf-8') as code:
            code.write(f'\n{line}\n')
    done = lint(tmp_path)
    assert done.returncode == 1
    names = {rule['id']: rule['name'] for rule in CONTRACTS}
    found = done.stdout.partition('Broken contracts')[2]
    for file, line, contract in FORBIDDEN:
        assert f'{names[contract]} BROKEN' in done.stdout.splitlines(), done.stdout + done.stderr
        heading = rf'^{re.escape(names[contract])}\n-+\n'
        (section,) = re.findall(rf'(?ms){heading}(.*?)(?=^-+\n|\Z)', found)
        assert Path(file).stem in section, f'{file}: {line}\n{found}'


def test_no_file_imports_itself_through_others(graph: grimp.ImportGraph) -> None:
    circles = [
        chain
        for name in sorted(graph.modules)
        for imported in sorted(graph.find_modules_directly_imported_by(name))
        for chain in [graph.find_shortest_chain(imported, name)]
        if chain
    ]
    assert circles == []


def test_nothing_may_import_what_it_does_not(graph: grimp.ImportGraph) -> None:
    for rule in CONTRACTS:
        for importer in rule.get('allowed_importers', ()):
            files = {importer, *graph.find_descendants(importer)}
            used = {i for file in files for i in graph.find_modules_directly_imported_by(file)}
            assert any(
                name == package or name.startswith(f'{package}.')
                for name in used
                for package in rule['protected_modules']
            ), f'{importer} imports nothing of {rule["id"]}'


def directions() -> list[list[str]]:
    """Return the chains of calls in CONTRIBUTING.md, from the outermost file to each file."""
    text = (ROOT / 'CONTRIBUTING.md').read_text(encoding='utf-8')
    chains: list[list[str]] = []
    for line in re.findall(r'^ *[a-z_]+/[a-z_/]+\.py', text, re.MULTILINE):
        depth = (len(line) - len(line.lstrip())) // 2
        chains.append([*(chains[-1][:depth] if depth else []), line.strip()])
    return chains


def test_the_ways_through_the_code_are_calls_that_enter_no_room_twice(
    graph: grimp.ImportGraph,
) -> None:
    assert len(directions()) > 50
    for chain in directions():
        names = [
            'shepherd_ros.' + file.removesuffix('.py').removesuffix('/__init__').replace('/', '.')
            for file in chain
        ]
        assert names[-1] in graph.modules
        for caller, called in pairwise(names):
            assert graph.direct_import_exists(importer=caller, imported=called), chain
        rooms = [room for room, _ in groupby(file.split('/')[0] for file in chain)]
        assert len(rooms) == len(set(rooms)), chain


def lengths(path: Path) -> Iterator[tuple[str, int]]:
    """Yield the functions of a file and how many lines each has."""
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.name, (node.end_lineno or 0) - node.lineno + 1


def test_files_and_functions_are_short() -> None:
    long = {}
    for path in sorted(path for folder in SHORT for path in (ROOT / folder).rglob('*.py')):
        name = path.relative_to(ROOT).as_posix()
        verb = path.parent.name == 'scripts' and path.stem != 'generate'  # or near to one
        limit = LONGEST_SCRIPT if verb else LONGEST_FILE
        lines = path.read_text(encoding='utf-8').count('\n')
        if lines > limit:
            long[name] = lines
        for function, lines in lengths(path):
            if lines > LONGEST_FUNCTION:
                long[f'{name}: {function}'] = lines
    assert long == {}


def shown(package: ModuleType) -> set[str]:
    """Return what a package says is public, and check that it is there."""
    names = set(package.__all__)
    modules = {info.name for info in iter_modules(package.__path__)}
    assert names <= modules | set(vars(package)), f'{package.__name__} shows what it has not'
    return names


def test_what_others_import_from_a_package_is_public() -> None:
    packages = {
        info.name: import_module(info.name)
        for info in walk_packages(shepherd_ros.__path__, 'shepherd_ros.')
        if info.ispkg
    }
    public = {name: shown(package) for name, package in packages.items()}
    hidden = set()
    paths = [path for folder in (*SHORT, 'test/plugins') for path in (ROOT / folder).rglob('*.py')]
    for path in paths:
        inside = '.'.join(path.relative_to(ROOT).parent.parts)
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            for alias in node.names if isinstance(node, ast.ImportFrom) else ():
                parts = f'{node.module}.{alias.name}'.split('.')
                for end in range(2, len(parts)):
                    package = '.'.join(parts[:end])
                    outside = not f'{inside}.'.startswith(f'{package}.')
                    if outside and package in public and parts[end] not in public[package]:
                        hidden.add(f'{package}.__all__ lacks {parts[end]!r}, as {path.name} needs')
    assert not hidden
