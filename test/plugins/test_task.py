"""A third task is one file: it is trained, evaluated, recorded, replayed, shown and in nodes."""

from __future__ import annotations

from pathlib import Path

from cli.test_train_verbs import NETWORK, TINY
from plugins.verbs import run
import pytest

pytestmark = pytest.mark.system

TASK = str(Path(__file__).parent / 'fetch.py')
WORLD = '--task fetch --shepherds 2 --steps 60'


def test_a_task_of_one_file_goes_everywhere(commands: Path, tmp_path: Path) -> None:
    bag = f'{tmp_path}/bags/episode_000000'
    *_, information, checked, replayed, shown, _ = run(
        commands / 'python',
        TASK,
        f'train ppo --task fetch {TINY} --fetch 2 {NETWORK} --out {tmp_path}/ppo',
        f'evaluate table --task fetch --shepherds 2 --steps 60 --sheep 5 --controllers strombom '
        f'--episodes 2 --set world.task.patience=2 --out {tmp_path}/rows',
        f'record {WORLD} --controller strombom --episodes 1 --out {tmp_path}/bags',
        f'bag info {bag} --metrics',
        f'bag check {bag}',
        f'replay {bag} --controller strombom --without-ros',
        f'demo {WORLD} --controller strombom --animation none --out {tmp_path}/demo',
        f'bag render {bag} --output {tmp_path}/page',
    )
    assert 'fetched' in (tmp_path / 'rows' / 'table.md').read_text()
    (file,) = Path(bag).glob('*.mcap')
    for stored in (b'"name": "fetch"', b'"end": "terminated"'):
        assert stored in file.read_bytes()
    assert 'Sheep: 5' in information
    assert 'whole' in information
    assert 'fetched' in information
    assert checked.splitlines()[-1] == 'ok'
    assert replayed.splitlines()[-1] == 'equal'
    assert 'fetched' in shown
    assert (tmp_path / 'demo' / 'tracks.png').exists()
    assert 'fetched' in (tmp_path / 'page' / 'replay.html').read_text()
