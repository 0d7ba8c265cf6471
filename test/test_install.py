"""pip install and colcon build, each from a fresh copy of the files."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import sysconfig
import venv
import xml.etree.ElementTree as ET

import pytest
from shepherd_ros.controllers import CONTROLLERS

rclpy = pytest.importorskip('rclpy')
pytestmark = [
    pytest.mark.system,
    pytest.mark.xdist_group('install'),  # one worker builds, once
    pytest.mark.skipif(
        not Path(rclpy.__file__).is_relative_to(sys.prefix), reason='needs rclpy from PyPI'
    ),
]

ROOT = Path(__file__).resolve().parents[1]
NODES = {'flock_sim', 'lidar', 'metrics', *(kind.executable for kind in CONTROLLERS.values())}
MARKER = 'share/ament_index/resource_index/packages/shepherd_ros'
FILES = ('package.xml', 'config/shepherd.rviz', 'launch/simulate.launch.py')
FILES += ('msg_schemas/topics.yaml', 'msg_schemas/geometry_msgs/PoseArray.msg')
FIND = 'from shepherd_ros.resources import share_file; print(share_file({!r}))'
FIND_ALL = f'[print(share_file(name)) for name in {FILES}]'
# what the wheels' start-up code leaves behind; another start of Python has to find it out anew
BOOTSTRAP = ('LD_LIBRARY_PATH', '_ROS_WHEELS_BOOTSTRAP_COMPLETE')

Run = Callable[..., str]


def environment(*without: str, **changes: str) -> dict[str, str]:
    """Return variables for a process of a user's: nothing of this checkout, nobody to talk to."""
    own = ('AMENT_PREFIX_PATH', 'COLCON_PREFIX_PATH', 'PYTHONPATH', 'VIRTUAL_ENV')
    stored = {key: value for key, value in os.environ.items() if key not in (*own, *without)}
    return stored | {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF'} | changes


def run(command: Iterable[str | Path], cwd: Path, env: dict[str, str]) -> str:
    """Return what a command prints; AssertionError with it if the command fails."""
    done = subprocess.run(
        [str(word) for word in command], cwd=cwd, env=env, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope='module')
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of the checkout in a workspace, without anything that was built."""
    target = tmp_path_factory.mktemp('workspace') / 'src' / 'shepherd_ros'
    built = ('.venv', '__pycache__', '*.egg-info', 'build', 'install', 'log', 'out')
    ignored = shutil.ignore_patterns('.git', '.hypothesis', '.*_cache', *built)
    return Path(shutil.copytree(ROOT, target, ignore=ignored))


@pytest.fixture(scope='module')
def prefix(copy: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a fresh virtual environment with the package, and ours lent for the rest."""
    prefix = tmp_path_factory.mktemp('prefix')
    venv.create(prefix, with_pip=False, symlinks=True)
    packages = Path(sysconfig.get_path('purelib', vars={'base': str(prefix)}))
    # a plain path: the .pth files over there, such as that of the checkout, are not followed
    (packages / 'lent.pth').write_text(sysconfig.get_path('purelib') + '\n')
    source = Path(shutil.copytree(copy, prefix / 'source'))
    command = 'install --quiet --no-deps --no-build-isolation --no-index --ignore-installed .'
    python = prefix / 'bin' / 'python'
    run([python, '-m', 'pip', *command.split()], source, environment(*BOOTSTRAP))
    return prefix


@pytest.fixture(scope='module')
def pip_env() -> dict[str, str]:
    """
    Return variables for the fresh environment.

    The libraries of ROS are those of the packages that are lent, hence our LD_LIBRARY_PATH.
    """
    return environment('_ROS_WHEELS_BOOTSTRAP_COMPLETE')


# ---- pip install . ----


def test_pip_installs_executables_and_shared_files(prefix: Path) -> None:
    for name in {*NODES, 'shepherd'}:
        assert os.access(prefix / 'bin' / name, os.X_OK), name
    assert (prefix / MARKER).is_file()
    for name in FILES:
        assert (prefix / 'share/shepherd_ros' / name).is_file(), name


def test_pip_executables_explain_themselves(
    prefix: Path, pip_env: dict[str, str], tmp_path: Path
) -> None:
    for name, words in (
        ('flock_sim', ('n_sheep (100)', 'mode (lockstep)', '/clock')),
        ('shepherd', ('demo',)),
    ):
        text = run([prefix / 'bin' / name, '--help'], tmp_path, pip_env)
        for word in words:
            assert word in text


@pytest.mark.parametrize('with_index', [False, True])
def test_pip_code_and_shared_files_are_found_from_anywhere(
    prefix: Path, pip_env: dict[str, str], tmp_path: Path, with_index: bool
) -> None:
    env = pip_env | ({'AMENT_PREFIX_PATH': str(prefix)} if with_index else {})
    code = 'import shepherd_ros; from shepherd_ros.resources import share_file; '
    code += f'print(shepherd_ros.__file__); {FIND_ALL}'
    module, *places = run([prefix / 'bin' / 'python', '-c', code], tmp_path, env).splitlines()
    assert Path(module).is_relative_to(prefix / 'lib')
    assert places == [str(prefix / 'share/shepherd_ros' / name) for name in FILES]


def test_code_of_a_checkout_uses_the_files_of_the_checkout(prefix: Path, tmp_path: Path) -> None:
    env = environment(*BOOTSTRAP, AMENT_PREFIX_PATH=str(prefix))
    output = run([sys.executable, '-c', FIND.format(FILES[0])], tmp_path, env)
    assert Path(output.strip()) == ROOT / FILES[0]


# ---- colcon build ----


@pytest.fixture(scope='module')
def colcon(copy: Path) -> Callable[..., str]:
    """Return a function that runs colcon in the workspace of the copy."""

    def call(*words: str) -> str:
        env = environment(*BOOTSTRAP, AMENT_PREFIX_PATH=sys.prefix)
        colcon = [sys.executable, '-m', 'colcon', '--log-base', 'log']
        return run([*colcon, *words], copy.parents[1], env)

    return call


@pytest.fixture(scope='module')
def install(copy: Path, colcon: Callable[..., str]) -> Path:
    """Return the folder of the package in a workspace that colcon has built."""
    colcon('build', '--packages-select', 'shepherd_ros')
    return copy.parents[1] / 'install' / 'shepherd_ros'


def sourced(install: Path, command: str, cwd: Path) -> str:
    """Return what a command prints after the workspace was sourced."""
    env = environment(*BOOTSTRAP, AMENT_PREFIX_PATH=sys.prefix)
    script = f'source {install.parent}/setup.bash && {command}'
    return run(['bash', '-c', script], cwd, env)


def test_colcon_installs_executables_and_shared_files(install: Path) -> None:
    for name in {*NODES, 'shepherd'}:
        assert os.access(install / 'lib/shepherd_ros' / name, os.X_OK), name
    assert (install / MARKER).is_file()
    for name in FILES:
        assert (install / 'share/shepherd_ros' / name).is_file(), name


def test_colcon_executables_run_in_the_environment_that_built_them(install: Path) -> None:
    for name in {*NODES, 'shepherd'}:
        first = (install / 'lib/shepherd_ros' / name).read_text().splitlines()[0]
        assert first == f'#!{sys.executable}', name


def test_a_wheel_has_all_files_of_the_package(copy: Path, prefix: Path) -> None:
    (package,) = prefix.glob('lib/python*/site-packages/shepherd_ros')

    def files(folder: Path) -> set[str]:
        found = (p for p in folder.rglob('*') if p.is_file() and '__pycache__' not in p.parts)
        return {p.relative_to(folder).as_posix() for p in found}

    assert files(copy / 'shepherd_ros') == files(package)
    shared = prefix / 'share/shepherd_ros'
    for folder in ('checkpoints', 'config', 'launch', 'msg_schemas'):
        assert files(copy / folder) == files(shared / folder), folder


def test_rosdep_and_one_pip_line_bring_all_that_pip_would() -> None:
    setup = (ROOT / 'setup.py').read_text(encoding='utf-8')
    listed = re.search(r'install_requires=\[(.*?)\]', setup, re.DOTALL)
    assert listed
    wanted = {re.split(r'\W', name)[0] for name in re.findall(r"'(.*?)',", listed[1])}
    manifest = ET.parse(ROOT / 'package.xml').getroot()
    keys = {e.text.removeprefix('python3-') for e in manifest.iter('exec_depend') if e.text
            and not e.get('condition')}  # fmt: skip
    text = (ROOT / 'docs/installation.md').read_text(encoding='utf-8')
    (line,) = re.findall(r'^pip install (torch.*)$', text, re.MULTILINE)
    by_pip = {re.split(r'\W', word.strip("'"))[0] for word in line.split()}
    known = keys | by_pip | {'pyyaml', 'pillow'}  # whose keys have other names
    assert wanted <= known | {'setuptools'}
    assert {'yaml', 'pil'} <= keys
    (torch,) = (e for e in manifest.iter('exec_depend') if e.text == 'python3-torch')
    assert torch.get('condition')
    # pip outside of an environment is refused, and executables get the Python that runs colcon
    assert 'python3 -m venv --system-site-packages venv && touch venv/COLCON_IGNORE\n' in text
    assert 'source venv/bin/activate\npip install torch' in text
    assert '\npython3 -m colcon build\n' in text


def test_colcon_code_and_executable_are_those_of_the_workspace(
    install: Path, tmp_path: Path
) -> None:
    code = f'import shepherd_ros; print(shepherd_ros.__file__); {FIND.format(FILES[0])}'
    flock_sim = install / 'lib/shepherd_ros/flock_sim'
    text = sourced(install, f'{sys.executable} -c "{code}" && {flock_sim} --help', tmp_path)
    module, file, *lines = text.splitlines()
    assert Path(module).is_relative_to(install)
    assert Path(file).is_relative_to(install)
    assert any('n_sheep (100)' in line for line in lines)


def test_colcon_test_runs_pytest(copy: Path, install: Path, colcon: Callable[..., str]) -> None:
    one = ('--pytest-args', 'test/test_viewers.py')
    colcon('test', '--packages-select', 'shepherd_ros', *one)
    results = ET.parse(copy.parents[1] / 'build/shepherd_ros/pytest.xml').getroot()
    suite = results if results.tag == 'testsuite' else results[0]
    assert int(suite.get('tests', '0')) > 5
    assert (suite.get('failures'), suite.get('errors')) == ('0', '0')
