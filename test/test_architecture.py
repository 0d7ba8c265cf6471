"""The rules of CONTRIBUTING.md: purity, style, manifest. Rooms: test_rooms.py."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint
from pathlib import Path
import re
import subprocess
import sys
from typing import Any

import pytest
import shepherd_ros
from shepherd_ros.controllers import CONTROLLERS
import yaml

ROOT = Path(__file__).resolve().parents[1]
CODE = ROOT / 'shepherd_ros'
MODULES = sorted(CODE.rglob('*.py'))

PURE = {'config', 'sim', 'controllers'}
WITH_ROS = {'nodes', 'ros'}
# a law of the world reads no file, no clock and no random state
IMPURE = {
    'csv', 'datetime', 'io', 'json', 'pathlib', 'pickle', 'random', 'secrets', 'shutil', 'socket',
    'sqlite3', 'subprocess', 'tempfile', 'threading', 'time',
}  # fmt: skip
GLOBAL_TOPICS = {'/clock', '/diagnostics', '/tf'}  # whose names ROS 2 fixes
ROSDEP = {'PIL': 'python3-pil'}  # where the key of rosdep is not python3-<package>
WITH_PIP = {  # not from rosdep
    'foxglove', 'gymnasium', 'imageio', 'lz4', 'mcap', 'numba', 'onnx', 'onnxruntime',
    'pettingzoo', 'pyarrow', 'rosbags', 'safetensors', 'stable_baselines3', 'torch', 'tyro',
    'zstandard',
}  # fmt: skip
PYPI = {  # where the distribution has another name
    'PIL': 'pillow',
    'foxglove': 'foxglove-sdk',
    'stable_baselines3': 'stable-baselines3',
    'yaml': 'pyyaml',
}


def is_ros(package: str) -> bool:
    """Return whether a package comes with ROS."""
    return package.endswith(('_msgs', '_srvs', '_interfaces')) or package in (
        'ament_index_python', 'launch', 'launch_ros', 'rclpy',
    )  # fmt: skip


def room_of(path: Path) -> str:
    """Return the room of a file of ours: its folder, or the file of the ground floor."""
    return path.relative_to(CODE).with_suffix('').parts[0]


@cache
def tree(path: Path) -> ast.Module:
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text(encoding='utf-8'), str(path))


def imports(node: ast.AST, lazy: bool = True) -> Iterator[str]:
    """Yield the full names of imported modules; lazy: also those that starting does not import."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and 'TYPE_CHECKING' in ast.dump(child.test) and not lazy:
            continue
        if isinstance(child, ast.Import):
            yield from (alias.name for alias in child.names)
        elif isinstance(child, ast.ImportFrom):
            assert child.level == 0, f'line {child.lineno}: a relative import'
            yield from (f'{child.module}.{alias.name}' for alias in child.names)
        elif lazy or not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from imports(child, lazy)


def tracked() -> list[Path]:
    """Return the files that git knows; skip the test without git."""
    try:
        listed = subprocess.run(
            ['git', 'ls-files', '-z'], cwd=ROOT, capture_output=True, check=True
        ).stdout.decode()
    except (OSError, subprocess.CalledProcessError):
        pytest.skip('this is no git checkout')
    paths = [ROOT / name for name in listed.split('\0') if name]
    return [path for path in paths if path.is_file()]


def short(path: Path) -> str:
    """Return a path as messages show it."""
    return path.relative_to(ROOT).as_posix()


# ---- imports ----


def test_laws_of_the_world_use_neither_files_nor_clock_nor_random_state() -> None:
    impure = re.compile(r'(torch|np)\.(rand|manual_seed|seed|Generator|save|load|from_file)')
    offenders = []  # random numbers come from sim.rng
    for path in MODULES:
        if room_of(path) in PURE:
            roots = {name.partition('.')[0] for name in imports(tree(path))}
            offenders += [f'{short(path)}: {name}' for name in roots & IMPURE]
            offenders += [
                f'{short(path)}:{node.lineno}: {ast.unparse(node)}'
                for node in ast.walk(tree(path))
                if isinstance(node, ast.Attribute) and impure.match(ast.unparse(node))
            ]
    assert not offenders


def test_commands_import_nodes_only_inside_functions() -> None:
    for path in MODULES:
        if room_of(path) == 'cli':
            early = set(imports(tree(path), lazy=False))
            assert not any(name.startswith('shepherd_ros.nodes') for name in early), short(path)


def test_everything_else_runs_without_ros() -> None:
    names = [
        '.'.join(path.relative_to(ROOT).with_suffix('').parts)
        for path in MODULES
        if room_of(path) not in WITH_ROS and path.name != '__main__.py'
    ]
    code = f"""
import importlib, sys
class NoRos:
    def find_spec(self, name, path=None, target=None):
        package = name.partition('.')[0]
        if package == 'rclpy' or package.endswith(('_msgs', '_srvs', '_interfaces')):
            raise AssertionError(name)
sys.meta_path.insert(0, NoRos())
for name in {names!r}:
    importlib.import_module(name.removesuffix('.__init__'))
"""
    command = [sys.executable, '-c', code]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


# ---- style ----


def test_topic_names_are_relative() -> None:
    for path in MODULES:
        if room_of(path) not in WITH_ROS:
            continue
        nodes = list(ast.walk(tree(path)))
        inner = {
            part for node in nodes if isinstance(node, ast.JoinedStr) for part in node.values[1:]
        }
        for node in nodes:
            if isinstance(node, ast.Constant) and re.match(r'/[A-Za-z]', str(node.value)):
                known = node.value in GLOBAL_TOPICS or node in inner
                assert known, f'{short(path)}:{node.lineno}: {node.value}'


def public(node: ast.AST, prefix: str = '') -> Iterator[tuple[str, Any]]:
    """Yield the functions, methods and classes that others may use."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If | ast.Try):
            yield from public(child, prefix)
        elif isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            if child.name.startswith('_') and not child.name.startswith('__'):
                continue
            yield f'{prefix}{child.name}', child
            if isinstance(child, ast.ClassDef):
                yield from public(child, f'{child.name}.')


def is_compiled(node: Any) -> bool:
    """Return whether a function is compiled, whose types numba finds."""
    return any(isinstance(d, ast.Name) and d.id == 'compiled' for d in node.decorator_list)


def test_whatever_is_public_says_what_it_is_and_returns() -> None:
    offenders = [f'{short(path)}' for path in MODULES if not ast.get_docstring(tree(path))]
    for path in MODULES:
        for name, node in public(tree(path)):
            if not ast.get_docstring(node):
                offenders.append(f'{short(path)}: {name} has no docstring')
            if not (isinstance(node, ast.ClassDef) or is_compiled(node) or node.returns):
                offenders.append(f'{short(path)}: {name} does not say what it returns')
    assert not offenders


NO_TERMS = {  # say the thing instead
    'asked', 'came', 'got', 'heard', 'kept', 'mine', 'ours', 'said', 'theirs', 'there', 'told',
    'way', 'ways', 'whose', 'why',
}  # fmt: skip
TESTS = sorted([*(ROOT / 'test').rglob('*.py'), *(ROOT / 'launch').rglob('*.py')])


def test_names_and_modules_say_the_thing() -> None:
    offenders = []
    for path in [*MODULES, *TESTS]:
        if re.match(r'(What|How|Where|Who|When)\b', ast.get_docstring(tree(path)) or ''):
            offenders.append(f'{short(path)}: its docstring begins with a question')
        for node in ast.walk(tree(path)):
            name = node.arg if isinstance(node, ast.arg) else ''
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                name = node.id
            if name in NO_TERMS:
                offenders.append(f'{short(path)}:{getattr(node, "lineno", 0)}: {name}')
    assert not offenders


def test_files_name_no_place_of_one_machine_and_leave_nothing_to_do() -> None:
    here = [f'/{"work"}/', f'{Path.home()}/']
    if len(ROOT.parts) > 2:
        here.append(str(ROOT))
    markers = re.compile(r'\b(T[O]DO|F[I]XME|X{3}|T[B]D)\b')  # not found in this line
    for path in tracked():
        try:
            text = path.read_text(encoding='utf-8')
        except UnicodeDecodeError:  # not a text
            continue
        for place in here:
            assert place not in text, f'{short(path)} names {place}'
        assert markers.findall(text) == [], short(path)


# ---- manifest and setup ----


@pytest.fixture(scope='module')
def manifest() -> Any:
    """Return package.xml as catkin_pkg reads it."""
    return pytest.importorskip('catkin_pkg.package').parse_package(str(ROOT / 'package.xml'))


@pytest.fixture(scope='module')
def distribution() -> Any:
    """Return what setup.py says, without running any of its commands."""
    import setuptools  # noqa: F401  (brings distutils)

    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        patch.setattr(sys, 'argv', ['setup.py'])
        return import_module('distutils.core').run_setup('setup.py', stop_after='init')


def all_imports(*folders: str) -> set[str]:
    """Return the packages of others that are imported anywhere in folders."""
    paths = [path for folder in folders for path in (ROOT / folder).rglob('*.py')]
    packages = {name.partition('.')[0] for path in paths for name in imports(tree(path))}
    return packages - sys.stdlib_module_names - {'shepherd_ros'}


def test_manifest_is_valid(manifest: Any) -> None:
    warnings: list[str] = []
    manifest.validate(warnings=warnings)
    assert warnings == []
    assert manifest.package_format == 3
    assert manifest.get_build_type() == 'ament_python'
    assert manifest.licenses == ['Apache-2.0']


def test_manifest_names_what_is_imported(manifest: Any) -> None:
    needed = {depend.name for depend in manifest.exec_depends}
    for package in all_imports('shepherd_ros', 'launch'):
        key = package if is_ros(package) else ROSDEP.get(package, f'python3-{package}')
        assert key in needed or package in WITH_PIP, f'package.xml has no exec_depend {key}'
    assert {depend.name for depend in manifest.test_depends} >= {'python3-pytest'}


def test_setup_names_what_is_imported(distribution: Any) -> None:
    extras = distribution.extras_require
    always = {re.split(r'[<>=\[]', name)[0] for name in distribution.install_requires}
    chosen = [name for key in ('fast', 'envs', 'sb3', 'onnx', 'foxglove') for name in extras[key]]
    optional = {re.split(r'[<>=\[]', name)[0] for name in chosen}
    for package in all_imports('shepherd_ros'):
        if not is_ros(package):
            assert PYPI.get(package, package) in always | optional, package
    assert 'pytest' in extras['test']  # by which colcon knows that there are tests to run


def test_setup_runs_what_needs_no_package() -> None:
    early = imports(tree(ROOT / 'shepherd_ros/nodes/executables.py'), lazy=False)
    assert {name.partition('.')[0] for name in early} <= sys.stdlib_module_names


def test_versions_agree(manifest: Any, distribution: Any) -> None:
    assert manifest.version == shepherd_ros.__version__ == distribution.get_version()
    changes = (ROOT / 'CHANGELOG.rst').read_text(encoding='utf-8')
    dated = rf'{re.escape(manifest.version)} \(\d{{4}}-\d\d-\d\d\)'  # as bloom reads it
    assert re.search(rf'^({dated}|Forthcoming)\n-+$', changes, re.MULTILINE)


def test_entry_points_resolve(distribution: Any) -> None:
    pytest.importorskip('rclpy')
    scripts = distribution.entry_points['console_scripts']
    targets = dict(line.split(' = ') for line in scripts)
    assert {'shepherd', 'flock_sim', 'lidar', 'metrics', 'controller'} <= set(targets)
    assert {kind.executable for kind in CONTROLLERS.values()} <= set(targets)
    for name, target in targets.items():
        assert callable(EntryPoint(name, target, 'console_scripts').load()), name


def test_whatever_lies_beside_the_code_is_installed(distribution: Any) -> None:
    installed = {Path(name) for _, names in distribution.data_files for name in names}
    for path in tracked():
        place = path.relative_to(ROOT)
        if place.parts[0] in ('launch', 'config', 'msg_schemas', 'resource'):
            assert place in installed, place
    for folder, names in distribution.data_files:
        for name in names:
            inside = name.startswith(('launch', 'config', 'msg_schemas'))
            assert not inside or folder == f'share/shepherd_ros/{Path(name).parent.as_posix()}'


def test_whatever_lies_among_the_code_is_installed(distribution: Any) -> None:
    patterns = {
        f'{package.replace(".", "/")}/{pattern}'
        for package, names in distribution.package_data.items()
        for pattern in names
    }
    for path in tracked():
        if path.is_relative_to(CODE) and path.suffix != '.py':
            place = path.relative_to(ROOT)
            assert any(place.match(pattern) for pattern in patterns), place


def test_hooks_and_workflow_are_what_they_seem() -> None:
    hooks = yaml.safe_load((ROOT / '.pre-commit-config.yaml').read_text(encoding='utf-8'))
    ids = {hook['id'] for repo in hooks['repos'] for hook in repo['hooks']}
    assert ids == {'ruff-check', 'ruff-format', 'codespell', 'large-files'}
    workflow = yaml.safe_load((ROOT / '.github/workflows/ci.yml').read_text(encoding='utf-8'))
    job = workflow['jobs']['test']
    assert 'kilted' in {row['ros'] for row in job['strategy']['matrix']['include']}
    steps = job['steps']
    commands = [f'make {target}' for target in ('lint', 'docs', 'test', 'test-system')]
    assert [step['run'] for step in steps if 'run' in step] == commands
    script = (ROOT / '.ci/run').read_text(encoding='utf-8').splitlines()
    assert [line for line in script if line.startswith('make')] == commands
    makefile = (ROOT / 'Makefile').read_text(encoding='utf-8')

    def rules(target: str) -> str:
        return makefile.partition(f'\n{target}: ')[2].partition('\n\n')[0]

    for linter in ('ruff check', 'ruff format --check', 'lint-imports', 'mypy', 'codespell'):
        assert f'/{linter}' in rules('lint'), linter
    assert "-m 'not system'" in rules('test')
    assert '-m system' in rules('test-system')


SAME_ROLE = {'main'}  # of an executable


def test_public_names_and_names_of_files_are_there_once() -> None:
    places: defaultdict[str, list[Path]] = defaultdict(list)
    for path in MODULES:
        if path.stem != '__init__':
            places[path.name].append(path)
        for node in tree(path).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                places[node.name].append(path)
            targets = node.targets if isinstance(node, ast.Assign) else []
            targets += [node.target] if isinstance(node, ast.AnnAssign) else []
            for name in (n for target in targets for n in ast.walk(target)):
                if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store):
                    places[name.id].append(path)
    twice = {
        name: [str(path.relative_to(CODE)) for path in paths]
        for name, paths in places.items()
        if len(paths) > 1 and not name.startswith('_') and name not in SAME_ROLE
    }
    assert not twice, 'rename all but one, or begin names that only their file uses with _'
