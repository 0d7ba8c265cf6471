"""The command `shepherd` as a whole: version, help, running nodes, asking a running world."""

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
