"""The command `shepherd` as a whole: version, help, running nodes, asking a running world."""

import json
from pathlib import Path
import sys
from typing import Any

import pytest
from shepherd_ros import __version__
from shepherd_ros.cli import main
from shepherd_ros.nodes import executables


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['--version']) == 0
    assert capsys.readouterr().out == f'shepherd_ros {__version__}\n'


@pytest.mark.parametrize('words', [[], ['bag'], ['checkpoint'], ['record'], ['run'], ['goal']])
def test_a_command_that_needs_more_shows_its_help(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 0
    assert 'usage: ' + ' '.join(['shepherd', *words]) in capsys.readouterr().out


def test_a_node_gets_the_words_after_its_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    got: list[Any] = []
    monkeypatch.setattr(sys, 'argv', [])
    monkeypatch.setattr(executables, 'lidar', lambda: got.append(sys.argv) or 3, raising=False)
    assert main(['run', 'lidar', '--ros-args', '-p', 'noise_std:=0.5']) == 3
    assert got == [['lidar', '--ros-args', '-p', 'noise_std:=0.5']]
    assert main(['run', 'lidr']) == 2
    assert "node is 'lidr': expected one of" in capsys.readouterr().err


@pytest.mark.parametrize(
    'words',
    [
        ['demo', '--steps', '10', '--out', '{}'],
        ['record', '--episodes', '1', '--out', '{}'],
        ['train', 'dagger', '--quick', '--out', '{}'],
        ['search', '--candidates', '1', '--out', '{}/x.jsonl'],
        ['evaluate', '--quick', '--out', '{}'],
        ['figures', 'rows', '--out', '{}'],
        ['checkpoint', 'random', '-o', '{}/x.safetensors'],
        ['checkpoint', 'export', 'imitation', '-o', '{}/x.pt'],
    ],
)
def test_a_folder_that_cannot_be_made_is_a_sentence(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'file'
    file.touch()
    assert main([word.format(file) for word in words]) == 2
    assert f'is {file}: expected a folder (' in capsys.readouterr().err


def test_episodes_of_other_options_do_not_go_into_the_same_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ['record', '--episodes', '1', '--steps', '2', '--sheep', '4', '--out', f'{tmp_path}']
    assert main([*words, '--controller', 'pierson']) == 0
    assert main([*words, '--controller', 'pierson']) == 0  # goes on
    assert main([*words, '--controller', 'policy:general']) == 2
    assert 'which holds something else: expected an empty folder' in capsys.readouterr().err
    assert main([*words, '--controller', 'policy:general', '--overwrite']) == 0
    made_by = json.loads((tmp_path / '.made_by.json').read_text())
    assert made_by['controller'] == 'policy:general'
