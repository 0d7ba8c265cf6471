"""Checkpoints: what is written is read, and what is damaged is refused by name."""

from __future__ import annotations

import json
from pathlib import Path
import sys
from textwrap import wrap

import pytest
from safetensors import safe_open
from safetensors.torch import save_file
from shepherd_ros.cli import main
from shepherd_ros.config import ConfigError
from shepherd_ros.learning.dagger_config import DaggerConfig
from shepherd_ros.learning.train_ppo import PPORunConfig
from shepherd_ros.policy.card import metrics_for
from shepherd_ros.policy.checkpoint import (
    checkpoint_file,
    load_policy,
    read_checkpoint_metadata,
    save_policy,
    shipped_checkpoints,
)
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.policy.torchscript import export_actor
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.metrics import shown
from shepherd_ros.sim.observation import ObservationConfig
from shepherd_ros.sim.tasks import TASKS
import torch

SMALL = PolicyConfig(
    decision_interval=1.0,
    lidar=LidarConfig(n_rays=64, contact='facing'),
    observation=ObservationConfig(
        frame_interval=2.0, unit=12.5, align='goal', range_min=1.5, none_value=-1.0
    ),
    network=NetworkConfig(filters_1=2, filters_2=3, hidden=4),
)


@pytest.fixture(scope='module')
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp('checkpoint') / 'small.safetensors'
    save_policy(path, Policy(SMALL), {'command': 'none', 'seed': 3})
    return path


def test_a_policy_comes_back_as_it_was(checkpoint: Path) -> None:
    torch.manual_seed(0)
    policy, back = Policy(SMALL), load_policy(str(checkpoint))
    assert back.config == SMALL
    for name, value in policy.state_dict().items():
        assert torch.equal(back.state_dict()[name], value), name
    frames = 20 * torch.rand(4, 3, 3, 64)
    assert torch.equal(policy.act(frames), back.act(frames))
    config, record, _ = read_checkpoint_metadata(checkpoint)
    assert (config, record) == (SMALL, {'command': 'none', 'seed': 3})
    assert [path.name for path in checkpoint.parent.iterdir()] == [checkpoint.name]


def test_a_file_that_cannot_be_written_is_an_error_of_the_system(tmp_path: Path) -> None:
    (tmp_path / 'best.part').mkdir()
    with pytest.raises(OSError, match='directory'):
        save_policy(tmp_path / 'best.safetensors', Policy(SMALL), {})


def test_names_that_are_no_checkpoint_are_refused(tmp_path: Path) -> None:
    for name in ('nobody', str(tmp_path), str(tmp_path / 'none.safetensors'), '../policy'):
        with pytest.raises(ConfigError, match=r'checkpoint is .*: expected'):
            load_policy(name)


def changed(source: Path, target: Path, **metadata: str | None) -> Path:
    """Write a checkpoint with other metadata."""
    with safe_open(source, framework='pt') as file:
        stored = dict(file.metadata())
        weights = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    stored |= {key: value for key, value in metadata.items() if value is not None}
    for key, value in metadata.items():
        if value is None:
            stored.pop(key, None)
    save_file(weights, target, stored)
    return target


@pytest.mark.parametrize(
    ('metadata', 'words'),
    [
        ({'format': 'another'}, "format 'another': expected 'shepherd_ros policy 1'"),
        ({'format': None}, 'format None'),
        ({'config': '{'}, 'damaged metadata'),
        ({'config': '[]'}, 'should be objects'),
        ({'record': None}, 'damaged metadata'),
        ({'config': '[' * 100_000}, 'damaged metadata'),
        ({'config': '{"hidden": 3}'}, "PolicyConfig field is 'hidden'"),
        (
            {'config': '{"decision_interval": -1.0}'},
            'interval is -1.0: expected a value in',
        ),
        ({'config': json.dumps(PolicyConfig().to_dict())}, 'expected .32, 3, 10.'),
        ({'config': json.dumps(SMALL.to_dict() | {'network': {'hidden': 16384}})}, 'expected'),
    ],
)
def test_metadata_that_does_not_fit_is_named(
    checkpoint: Path, tmp_path: Path, metadata: dict[str, str | None], words: str
) -> None:
    path = changed(checkpoint, tmp_path / 'odd.safetensors', **metadata)
    with pytest.raises(ConfigError, match=words):
        load_policy(str(path))


def test_weights_that_are_missing_odd_or_not_finite_are_named(
    checkpoint: Path, tmp_path: Path
) -> None:
    with safe_open(checkpoint, framework='pt') as file:
        metadata = file.metadata()
        weights = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    name = 'actor.head.bias'
    for odd, words in (
        ({k: v for k, v in weights.items() if k != name}, 'missing or too many'),
        (weights | {'extra': torch.ones(1)}, "'extra' are missing or too many"),
        (weights | {name: torch.ones(5)}, r'\(5,\), expected \(4,\)'),
        (weights | {name: torch.full((4,), torch.nan)}, 'not all finite'),
    ):
        path = tmp_path / 'odd.safetensors'
        save_file(odd, path, metadata)
        with pytest.raises(ConfigError, match=words):
            load_policy(str(path))


def test_what_a_terminal_or_a_reader_cannot_bear_is_not_shown(
    checkpoint: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = changed(checkpoint, tmp_path / 'odd.safetensors', version='\x1b[2J')
    assert main(['checkpoint', 'info', str(path)]) == 0
    output = capsys.readouterr().out
    assert r"shepherd_ros '\x1b[2J'" in output
    assert '\x1b[2J' not in output
    config = json.dumps({'layout': 'x' * 10_000})
    path = changed(checkpoint, tmp_path / 'long.safetensors', config=config)
    assert main(['checkpoint', 'info', str(path)]) == 2
    assert len(capsys.readouterr().err) < 1000


def test_info_is_a_page_for_people_and_json_for_programs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv('COLUMNS', '80')
    for name in shipped_checkpoints():
        path = checkpoint_file(name)
        config, record, version = read_checkpoint_metadata(path)
        assert main(['checkpoint', 'info', name, '--json', '--weights']) == 0
        printed = json.loads(capsys.readouterr().out)
        assert printed['weights'] == {
            key: list(value.shape) for key, value in load_policy(name).state_dict().items()
        }
        del printed['weights']
        assert printed == {
            'file': str(path),
            'size': path.stat().st_size,
            'version': version,
            'policy': config.to_dict(),
            'record': record,
        }
        assert main(['checkpoint', 'info', name]) == 0
        first, *lines = (line.rstrip() for line in capsys.readouterr().out.splitlines())
        assert first.startswith(f'{path}, ')
        assert len(lines) < 80
        assert max(map(len, lines)) <= 80
        rows = [(line[2:22].strip(), line[24:]) for line in lines]
        task, measured = record['config']['run']['task'], record['eval']
        assert ('flock', task['flock']) in rows
        sheep = {task['sheep_min']: None, task['sheep_max']: None}
        assert ('sheep', ' to '.join(map(str, sheep))) in rows
        for metric in (m for m in shown('eval', metrics_for(config)) if m.name in measured):
            label = wrap(metric.short, 20)[0]  # the rest of a long one is below
            assert (label, f'{measured[metric.name]:.4g}') in rows
        assert TASKS[config.task].achieved in measured
        assert ('lidar', f'{config.lidar.n_rays} rays up to {config.lidar.range_max:g} m') in rows


def test_shipped_checkpoints_say_how_they_were_made() -> None:
    for name in shipped_checkpoints():
        record = read_checkpoint_metadata(checkpoint_file(name))[1]
        for key in ('command', 'seed', 'wall_time_s', 'code'):
            assert key in record
        last = record['command'].split(' && ')[-1]
        run = DaggerConfig if 'dagger' in last else PPORunConfig
        run.from_dict(record['config']['run'])  # every option by the name that it has now
        PolicyConfig.from_dict(record['config']['policy'])


def test_an_option_by_its_name_of_before_is_refused_with_that_of_now(
    checkpoint: Path, tmp_path: Path
) -> None:
    config = json.dumps({'decision_intervall': 0.5})
    path = changed(checkpoint, tmp_path / 'old.safetensors', config=config)
    with pytest.raises(
        ConfigError, match=r"'decision_intervall': .*did you mean 'decision_interval'"
    ):
        load_policy(str(path))


@pytest.mark.parametrize(
    'record',
    [
        {},
        {'command': '\x1b[2J', 'note': '`|`', 'eval': 3, 'progress': [], 'config': 'x'},
        {'eval': {'return': 'x'}, 'progress': {'samples': 'y'}, 'config': {'run': 7}},
    ],
)
def test_a_card_of_an_odd_record_is_still_one(
    record: dict[str, object], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'odd.safetensors'
    save_policy(path, Policy(SMALL), record)
    assert main(['checkpoint', 'card', str(path)]) == 0
    text = capsys.readouterr().out
    assert text.startswith('# Checkpoint `odd`')
    assert '\x1b' not in text


def test_an_export_does_the_same_in_any_batch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy = Policy(SMALL)
    assert export_actor(policy, tmp_path / 'actor.pt') < 1e-5
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, 'onnxruntime', None)
        with pytest.raises(ConfigError, match=r'install it: pip install .*onnx'):
            export_actor(policy, tmp_path / 'actor.onnx')
    assert export_actor(policy, tmp_path / 'actor.onnx') < 1e-5
