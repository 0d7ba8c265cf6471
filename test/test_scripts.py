"""Scripts that are a verb by another name pass everything on."""

from __future__ import annotations

import json
from pathlib import Path
import re
import runpy
import subprocess
import sys

import pytest
from shepherd_ros import cli

SCRIPTS = Path(__file__).resolve().parents[1] / 'scripts'
VERBS = {
    'build_dataset': ['dataset', 'build'],
    'demo': ['demo'],
    'evaluate': ['evaluate'],
    'record_demos': ['record'],
    'train_bc': ['train', 'bc'],
    'train_dagger': ['train', 'dagger'],
    'train_ppo': ['train', 'ppo'],
}


@pytest.mark.parametrize('name', VERBS)
def test_a_script_is_its_verb(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = SCRIPTS / f'{name}.py'
    received = []

    def main(arguments: list[str] | None = None) -> int:
        received.append(sys.argv[1:] if arguments is None else arguments)
        return 7

    monkeypatch.setattr(cli, 'main', main)
    monkeypatch.setattr(sys, 'argv', [str(path), '--out', 'place', 'bag'])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(path), run_name='__main__')
    assert end.value.code == 7
    assert received == [[*VERBS[name], '--out', 'place', 'bag']]
    text = path.read_text(encoding='utf-8')
    assert f'the same as `shepherd {" ".join(VERBS[name])}`' in text
    assert text.startswith('#!/usr/bin/env python3\n')
    assert path.stat().st_mode & 0o100


def test_every_verb_that_is_named_is_there() -> None:
    thin = {path.stem for path in SCRIPTS.glob('*.py') if 'import main' in path.read_text()}
    assert thin == set(VERBS)


def test_a_mistake_ends_in_words_and_not_in_a_traceback(commands: Path, tmp_path: Path) -> None:
    command = [commands / 'python', SCRIPTS / 'train_bc.py', '--out', 'x']
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2
    assert re.match(r'shepherd: .*expected', done.stderr)
    assert 'Traceback' not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_record_of_a_run_names_the_whole_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = ['--policy.lidar.n-rays', '64', '--policy.network.hidden', '4', '--batch-size', '8']
    few = ['--rounds', '1', '--steps-per-round', '2', '--groups', '1', '--worlds', '1']
    out = tmp_path / 'run'
    few += ['--updates-per-round', '1', '--eval-episodes', '2', '--eval-steps', '2']
    words = ['--out', str(out), *small, *few]
    path = SCRIPTS / 'train_dagger.py'
    monkeypatch.setattr(sys, 'argv', [str(path), *words])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(path), run_name='__main__')
    assert end.value.code == 0
    record = json.loads((out / 'run.json').read_text(encoding='utf-8'))
    assert record['command'] == 'shepherd train dagger ' + ' '.join(words)
