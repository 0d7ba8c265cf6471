"""A flock model, a controller and a parameter of the world are one file each: they go anywhere."""

from __future__ import annotations

from pathlib import Path
import sys

from cli.test_train_verbs import LESSONS, NETWORK, TINY
from plugins.verbs import run
import pytest

pytestmark = pytest.mark.system

HERE = Path(__file__).parent
PLUGINS = ','.join(str(HERE / f'{name}.py') for name in ('lazy', 'lead', 'wind', 'near'))
WORLD = '--sheep 4 --shepherds 2 --steps 12'


def test_plug_ins_of_one_file_are_trained_evaluated_recorded_replayed_and_in_every_node(
    commands: Path, tmp_path: Path
) -> None:
    bag = f'{tmp_path}/bags/episode_000000'
    changed = f'{WORLD} --flock lazy --set world.wind=0.5'
    *_, replayed, shown = run(
        commands / 'python',
        PLUGINS,
        f'train ppo {TINY} --flock lazy --wind 0.5 {NETWORK} --out {tmp_path}/ppo',
        f'train dagger {LESSONS} --teacher lead {NETWORK} --out {tmp_path}/dagger',
        f'evaluate table {changed} --controllers lead --episodes 2 --out {tmp_path}/rows',
        f'record {changed} --controller lead --episodes 1 --out {tmp_path}/bags',
        f'bag check {bag}',
        f'replay {bag} --controller lead --without-ros',
        f'demo {changed} --controller lead --animation none --out {tmp_path}/demo',
    )
    assert (tmp_path / 'ppo' / 'best.safetensors').exists()
    assert (tmp_path / 'dagger' / 'best.safetensors').exists()
    assert 'lead' in (tmp_path / 'rows' / 'table.md').read_text()
    (file,) = Path(bag).glob('*.mcap')
    for stored in (b'"fear_range": 6.0', b'"wind": 0.5'):
        assert stored in file.read_bytes()
    assert 'lead' in replayed
    assert 'fraction_reached' in shown
    assert 'fraction_near' in shown  # a metric from one file
    assert (tmp_path / 'demo' / 'tracks.png').exists()


def test_an_installed_package_names_its_plug_in_by_an_entry_point(tmp_path: Path) -> None:
    about = tmp_path / 'lead-1.0.dist-info'
    about.mkdir()
    (about / 'METADATA').write_text('Metadata-Version: 2.1\nName: lead\nVersion: 1.0\n')
    (about / 'entry_points.txt').write_text('[shepherd_ros.plugins]\nlead = lead\n')
    (tmp_path / 'lead.py').write_text((HERE / 'lead.py').read_text())
    run(
        Path(sys.executable),
        '',
        f'evaluate table {WORLD} --controllers lead --episodes 1 --out {tmp_path}/rows',
        PYTHONPATH=f'{tmp_path}:{HERE.parents[1]}',
    )
    assert 'lead' in (tmp_path / 'rows' / 'table.md').read_text()
