"""A flock model, a controller and whatever else is one file: it goes wherever ours go."""

from __future__ import annotations

import json
import os
from pathlib import Path
import subprocess
import sys

from cli.test_train_verbs import LESSONS, NETWORK, TINY
import pytest

HERE = Path(__file__).parent
WORLD = '--sheep 4 --shepherds 2 --steps 12'
# plug-in -> words of training, those of all verbs that run episodes, controller, seen in the bag
PLUGINS = {
    'lazy': (f'ppo {TINY} --flock lazy', '--flock lazy', 'drover', '"fear_range": 6.0'),
    'lead': (f'dagger {LESSONS} --teacher lead', '', 'lead', ''),
    'wind': (f'ppo {TINY} --wind 0.5', '--set world.wind=0.5', 'drover', '"wind": 0.5'),
}
VERBS = """
import json, sys
from shepherd_ros.cli import main
for words in json.loads(sys.argv[1]):
    code = main(words)
    if code:
        sys.exit(f'{words}: {code}')
"""


def shepherd(*commands: str, **variables: str) -> str:
    """Return what verbs print in a process of their own; all have to end well."""
    words = json.dumps([command.split() for command in commands])
    done = subprocess.run(
        [sys.executable, '-c', VERBS, words],
        env=os.environ | variables,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.timeout(300)
@pytest.mark.parametrize('name', PLUGINS)
def test_a_plug_in_of_one_file_is_trained_evaluated_recorded_and_replayed(
    name: str, tmp_path: Path
) -> None:
    training, setting, controller, stored = PLUGINS[name]
    bag = f'{tmp_path}/bags/episode_000000'
    said = shepherd(
        f'train {training} {NETWORK} --out {tmp_path}/run',
        f'evaluate table {WORLD} {setting} --controllers {controller} --episodes 2 '
        f'--out {tmp_path}/rows',
        f'record {WORLD} {setting} --controller {controller} --episodes 1 --out {tmp_path}/bags',
        f'bag check {bag}',
        f'replay {bag} --controller {controller} --without-ros',
        SHEPHERD_ROS_PLUGINS=str(HERE / f'{name}.py'),
    )
    assert controller in said
    assert (tmp_path / 'run' / 'best.safetensors').exists()
    assert controller in (tmp_path / 'rows' / 'table.md').read_text()
    (file,) = Path(bag).glob('*.mcap')
    assert stored.encode() in file.read_bytes()


@pytest.mark.timeout(300)
@pytest.mark.parametrize('name', PLUGINS)
def test_a_plug_in_of_one_file_is_in_every_node(name: str, tmp_path: Path) -> None:
    pytest.importorskip('rclpy')
    _, setting, controller, _ = PLUGINS[name]
    said = shepherd(
        f'demo {WORLD} {setting} --controller {controller} --animation none --out {tmp_path}',
        SHEPHERD_ROS_PLUGINS=str(HERE / f'{name}.py'),
    )
    assert 'fraction_reached' in said
    assert (tmp_path / 'tracks.png').exists()


def test_an_installed_package_names_its_plug_in_by_an_entry_point(tmp_path: Path) -> None:
    about = tmp_path / 'lead-1.0.dist-info'
    about.mkdir()
    (about / 'METADATA').write_text('Metadata-Version: 2.1\nName: lead\nVersion: 1.0\n')
    (about / 'entry_points.txt').write_text('[shepherd_ros.plugins]\nlead = lead\n')
    (tmp_path / 'lead.py').write_text((HERE / 'lead.py').read_text())
    shepherd(
        f'evaluate table {WORLD} --controllers lead --episodes 1 --out {tmp_path}/rows',
        PYTHONPATH=f'{tmp_path}:{HERE.parents[1]}',
    )
    assert 'lead' in (tmp_path / 'rows' / 'table.md').read_text()
