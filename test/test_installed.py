"""The scan for packages that tests need follows our own files and mistakes none for a package."""

import re
import sys
import xml.etree.ElementTree as ET

from installed import HERE, needed, required

ROOT = HERE.parent
OTHER_NAMES = {
    'PIL': 'pillow', 'yaml': 'pyyaml', 'mcap_ros2': 'mcap-ros2-support', 'grimp': 'import-linter',
    'importlinter': 'import-linter', 'pkg_resources': 'setuptools', 'foxglove': 'foxglove-sdk',
}  # fmt: skip


def test_packages_are_found_through_our_own_files() -> None:
    assert {'pytest', 'rclpy', 'torch', 'safetensors'} <= needed(HERE / 'nodes/test_parity.py')
    assert 'rclpy' not in needed(HERE / 'sim/test_env.py')
    assert {'mcap', 'PIL', 'tyro', 'yaml'} <= needed(HERE / 'nodes/test_imports.py')
    assert 'imageio' in required()


def test_each_package_that_a_test_needs_is_in_setup_or_manifest() -> None:
    quoted = re.findall(r"'([a-z][\w-]*)", (ROOT / 'setup.py').read_text(encoding='utf-8'))
    manifest = ET.parse(ROOT / 'package.xml').getroot()
    known = {*sys.stdlib_module_names, *quoted, *(str(e.text) for e in manifest)}
    for path in HERE.rglob('test_*.py'):
        for name in needed(path):
            distribution = OTHER_NAMES.get(name, name)
            assert {distribution, distribution.replace('_', '-')} & known, f'{name} of {path}'
