"""The command `shepherd` as a whole: version, help, running nodes, asking a running world."""

from contextlib import suppress
import json
from pathlib import Path
import re
import subprocess
import sys
from typing import Any

import pytest
from rosbag2.tiny import tiny_bag
from shepherd_ros import __version__, cli
from shepherd_ros.cli import main
from shepherd_ros.cli.demo_verb import Demo
from shepherd_ros.experiments.setting import env_config, Setting
from shepherd_ros.nodes import executables
from shepherd_ros.sim.metrics import shown
from shepherd_ros.sim.rollout import advance, start
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import stack
import torch


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['--version']) == 0
    assert capsys.readouterr().out == f'shepherd_ros {__version__}\n'


@pytest.mark.parametrize(
    ('module', 'message'),
    [
        ('torch.nn', 'torch is not installed: pip install torch'),
        ('foxglove', 'foxglove is not installed: pip install foxglove-sdk'),
        ('rclpy', "rclpy is not installed: pip install 'shepherd_ros[jazzy]'"),
    ],
)
def test_a_package_that_is_missing_is_named(
    module: str, message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing(*arguments: Any) -> Any:
        raise ModuleNotFoundError(f'No module named {module!r}', name=module)

    monkeypatch.setattr(cli, 'all_verbs', missing)
    monkeypatch.setattr(executables, 'import_module', missing)
    monkeypatch.setattr(executables.signal, 'signal', lambda *arguments: None)
    assert (main(['bag', 'info']), executables.foxglove()) == (2, 2)
    assert capsys.readouterr().err == f'shepherd: {message}\nfoxglove: {message}\n'
    module = 'shepherd_ros.nothing'  # is a fault of ours
    with pytest.raises(ModuleNotFoundError, match='nothing'):
        main(['bag', 'info'])


def test_the_demo_counts_its_metrics_from_every_state_that_it_has_heard() -> None:
    setting = Setting(sheep=4, shepherds=2, steps=5)
    config = env_config(setting)
    moments = [start(spawn(config.world, torch.tensor(3)), config)]
    for _ in range(config.world.episode_steps):
        moments.append(advance(moments[-1], torch.ones(2, 2)))
    table = Demo._table(stack([moment.state for moment in moments]), setting)
    names, values = ([*column.cells] for column in table.columns[:2])
    assert names == [metric.name for metric in shown('summary', config.world.task.metrics)]
    metrics = moments[-1].metrics()
    assert values == [f'{float(metrics[name]):.4g}' for name in names]


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
    result: list[Any] = []
    monkeypatch.setattr(sys, 'argv', [])
    monkeypatch.setattr(executables, 'lidar', lambda: result.append(sys.argv) or 3, raising=False)
    assert main(['run', 'lidar', '--ros-args', '-p', 'noise_std:=0.5']) == 3
    assert result == [['lidar', '--ros-args', '-p', 'noise_std:=0.5']]
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


@pytest.mark.parametrize(
    'words',
    [
        ['demo', '--steps', '10', '--out', '{}'],
        ['train', 'dagger', '--quick', '--out', '{}'],
        ['evaluate', '--quick', '--out', '{}'],
        ['figures', 'rows', '--out', '{}'],
        ['bag', 'render', '{bag}', '-o', '{}'],
        ['counterfactual', '{bag}', '--at', '1', '--out', '{}'],
        ['dataset', 'build', '{bag}', '--out', '{}'],
        ['bag', 'recover', '{bag}', '-o', '{}'],
        ['checkpoint', 'random', '-o', '{}/notes.safetensors'],
        ['checkpoint', 'export', 'imitation', '-o', '{}/notes.pt'],
        ['search', '--candidates', '1', '--out', '{}/notes.pt'],
    ],
    ids=lambda words: ' '.join(words[:2]),
)
def test_what_others_have_written_stays(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, out = tiny_bag(tmp_path / 'bag'), tmp_path / 'out'
    out.mkdir()
    for name in ('notes.safetensors', 'notes.pt'):
        (out / name).write_text('mine')
    assert main([word.format(out, bag=bag) for word in words]) == 2
    output = capsys.readouterr().err
    assert str(out) in output
    assert re.search('which holds something else|already|is no candidate', output)
    assert sorted(path.name for path in out.iterdir()) == ['notes.pt', 'notes.safetensors']
    assert {path.read_text() for path in out.iterdir()} == {'mine'}


def test_a_verb_writes_again_where_it_has_written_and_beside_others_if_it_may(
    tmp_path: Path,
) -> None:
    bag, out = tiny_bag(tmp_path / 'bag'), tmp_path / 'out'
    render = ['bag', 'render', str(bag), '-o', str(out)]
    assert main(render) == 0
    (out / 'notes').touch()
    assert main(render) == 0
    (out / 'replay.html').unlink()
    assert main(render) == 2
    assert main([*render, '--overwrite']) == 0
    assert {path.name for path in out.iterdir()} == {
        'notes', 'tracks.png', 'herding.gif', 'replay.html'
    }  # fmt: skip
    file = tmp_path / 'some.safetensors'
    random = ['checkpoint', 'random', '-o', str(file)]
    assert [main(random), main(random), main([*random, '--overwrite'])] == [0, 2, 0]


COMPLETE = """
source {script}
complete_words() {{
  COMP_WORDS=("$@") COMP_CWORD=$(($# - 1)) COMPREPLY=()
  _tyro_shepherd shepherd "${{COMP_WORDS[COMP_CWORD]}}" "${{COMP_WORDS[COMP_CWORD - 1]}}"
  echo "${{COMPREPLY[@]}}"
}}
complete -p shepherd
complete_words shepherd do
complete_words shepherd bag re
complete_words shepherd record --compression ''
complete_words shepherd train ppo --sam
"""


def test_bash_completes_verbs_options_and_choices(tmp_path: Path) -> None:
    script = tmp_path / 'shepherd.bash'
    with suppress(SystemExit):
        main(['--tyro-write-completion', 'bash', str(script)])
    words = ['bash', '--norc', '-c', COMPLETE.format(script=script)]
    output = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert output.splitlines() == [
        'complete -F _tyro_shepherd shepherd',
        'doctor',
        'recover render',
        'none zstd lz4',
        '--samples',
    ]
