"""Package shepherd_ros: installs with pip and with colcon alike."""

from pathlib import Path
import re
import runpy
import xml.etree.ElementTree as ET

from setuptools import find_packages, setup

NAME = 'shepherd_ros'
HERE = Path(__file__).parent
MANIFEST = ET.parse(HERE / 'package.xml').getroot()


def heuristics() -> list[str]:
    """Return the executables of controllers, read from their files: importing them takes torch."""
    files = sorted((HERE / NAME / 'controllers').glob('*.py'))
    text = '\n'.join(path.read_text(encoding='utf-8') for path in files)
    return re.findall(r"^    executable = '(\w+)'$", text, re.MULTILINE)


FILES = runpy.run_path(str(HERE / NAME / 'nodes' / 'executables.py'))['FILES']
EXECUTABLES = sorted({*FILES, *heuristics()})


def shared(folder: str, pattern: str) -> tuple[str, list[str]]:
    """Return a row of data_files: where the files of a folder go, and which."""
    files = sorted(str(p.relative_to(HERE)) for p in (HERE / folder).glob(pattern) if p.is_file())
    return f'share/{NAME}/{folder}', files


setup(
    name=NAME,
    version=MANIFEST.findtext('version'),
    packages=find_packages(exclude=['test', 'test.*']),
    package_data={f'{NAME}.view': ['*.css', '*.html', '*.js']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        shared('checkpoints', '*.safetensors'),
        shared('launch', '*.launch.py'),
        shared('config', '*'),
        shared('msg_schemas', '*.*'),
        *(
            shared(str(folder.relative_to(HERE)), '*.msg')
            for folder in sorted((HERE / 'msg_schemas').iterdir())
            if folder.is_dir()
        ),
    ],
    install_requires=[
        'setuptools',
        'imageio[ffmpeg]',
        'lz4',
        'matplotlib',
        'mcap',
        'numpy',
        'pillow',
        'pyarrow',
        'pyyaml',
        'rich',
        'rosbags',
        'safetensors',
        'tensorboard',
        'torch',
        'tornado',
        'tyro',
        'zstandard',
    ],
    extras_require={
        'jazzy': ['ros-jazzy-rclpy[fastrtps]', 'ros-jazzy-common-interfaces'],
        'kilted': ['ros-kilted-rclpy[fastrtps]', 'ros-kilted-common-interfaces'],
        'fast': ['numba'],
        'envs': ['gymnasium', 'pettingzoo'],
        'sb3': ['gymnasium', 'pettingzoo', 'stable-baselines3'],
        'onnx': ['onnx', 'onnxruntime'],
        'bench': ['vmas'],
        'foxglove': ['foxglove-sdk'],
        'mutation': ['cosmic-ray', 'coverage'],
        'docs': ['furo', 'myst-parser', 'sphinx', 'sphinx-copybutton'],
        'test': ['pytest'],
        'dev': [
            'axe-core-python',
            'catkin-pkg',
            'codespell',
            'colcon-common-extensions',
            'colcon-ros',
            'foxglove-sdk',
            'hypothesis',
            'import-linter',
            'jsonschema',
            'mcap-ros2-support',
            'mypy',
            'onnx',
            'onnxruntime',
            'pandas',
            'pytest<9',
            'pytest-timeout',
            'pytest-xdist',
            'ruff',
            'selenium',
            'setuptools<80',
            'stable-baselines3',
            'types-PyYAML',
        ],
    },
    zip_safe=False,
    author=MANIFEST.find('maintainer').text,
    maintainer=MANIFEST.find('maintainer').text,
    maintainer_email=MANIFEST.find('maintainer').get('email'),
    description=' '.join(MANIFEST.findtext('description').split()),
    license='Apache-2.0',
    python_requires='>=3.11',
    entry_points={
        'console_scripts': [
            'shepherd = shepherd_ros.entry_points:shepherd',
            *(f'{name} = {NAME}.entry_points:{name}' for name in EXECUTABLES),
        ],
    },
)
