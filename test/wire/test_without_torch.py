"""Messages, bags, recorder and player start without torch, which would take a second."""

from __future__ import annotations

import importlib
import pkgutil
import subprocess
import sys

import pytest

ROOMS = ('wire', 'rosbag2')
FILES = (
    'recordings.grouping', 'recordings.episodes', 'recordings.check', 'recordings.info',
    'recordings.export', 'recordings.recording_writer', 'datasets.steps',
    'datasets.dataset_report',
    'datasets.lerobot_reader', 'datasets.lerobot_writer', 'cli.bag_verbs', 'ros.runtime',
    'nodes.player_node', 'nodes.recorder_node', 'nodes.controller_probe',
)  # fmt: skip


def modules(room: str) -> list[str]:
    """Return the names of all modules of a room."""
    package = importlib.import_module(f'shepherd_ros.{room}')
    return [f'{room}.{found.name}' for found in pkgutil.iter_modules(package.__path__)]


CASES = {**{room: modules(room) for room in ROOMS}, 'bags': FILES}


@pytest.mark.parametrize('names', CASES.values(), ids=list(CASES))
def test_torch_is_not_imported(names: list[str]) -> None:
    lines = ['import sys', *(f'import shepherd_ros.{name}' for name in names)]
    lines.append("sys.exit(str([name for name in ('torch', 'numba') if name in sys.modules]))")
    code = '\n'.join(lines)
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
    assert done.stderr == '[]\n'


@pytest.mark.parametrize('room', ROOMS)
def test_ros_is_not_imported(room: str) -> None:
    imports = '; '.join(f'import shepherd_ros.{name}' for name in modules(room))
    code = f"import sys; {imports}; sys.exit(str('rclpy' in sys.modules))"
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
    assert done.stderr == 'False\n'
