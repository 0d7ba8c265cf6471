"""A node imports no package that it does not need: fresh processes, least needs first."""

from __future__ import annotations

from importlib.util import find_spec
import json
from pathlib import Path
import re
import subprocess
import sys

import pytest

SETUP = Path(__file__).resolve().parents[2] / 'setup.py'
OTHER_NAMES = {'pillow': 'PIL', 'pyyaml': 'yaml'}
BY_RCLPY = {'yaml', 'setuptools'}
BAGS = {'numpy', 'mcap', 'lz4', 'zstandard', 'tyro'}
LAWS = {'numpy', 'torch'} | ({'numba'} if find_spec('numba') else set())
NEEDS = {
    'bags': {'world_client': {'numpy'}, 'flock_commands': {'numpy'}, 'mux_node': {'numpy'},
             'foxglove_node': {'numpy'}, 'player_node': BAGS,
             'recorder_node': BAGS, 'console_node': BAGS | {'tornado'}},
    'laws': {'flock_node': LAWS, 'lidar_node': LAWS, 'metrics_node': LAWS, 'heuristic_node': LAWS,
             'policy_node': LAWS | {'safetensors'}, 'herd_node': LAWS | {'safetensors', 'tyro'}},
}  # fmt: skip


def packages() -> set[str]:
    """Return the names that packages of setup.py are imported by, but for those of rclpy."""
    listed = re.findall(r"^        '([\w-]+)[^']*',$", SETUP.read_text(encoding='utf-8'), re.M)
    extras = re.findall(r"^        '(?:fast|sb3|onnx)': \[(.*)\]", SETUP.read_text(), re.M)
    listed += re.findall(r"'([\w-]+)'", ' '.join(extras))
    return {OTHER_NAMES.get(name, name.replace('-', '_')) for name in listed} - BY_RCLPY


def test_the_packages_of_setup_are_found() -> None:
    assert {'torch', 'PIL', 'imageio', 'rosbags', 'numba', 'stable_baselines3'} <= packages()


@pytest.mark.parametrize('room', NEEDS)
def test_a_node_imports_what_it_needs_and_no_more(room: str) -> None:
    code = f"""
import importlib, json, sys
for name in {list(NEEDS[room])}:
    importlib.import_module('shepherd_ros.nodes.' + name)
    print(json.dumps([name, sorted({packages()!r} & sys.modules.keys())]))
"""
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = dict(json.loads(line) for line in done.stdout.splitlines())
    assert {name: set(names) for name, names in found.items()} == NEEDS[room]
