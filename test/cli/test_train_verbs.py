"""The verbs of `shepherd train`: what they take, what they print, and where they go on."""

from __future__ import annotations

from contextlib import suppress
import json
from pathlib import Path
import re

import pytest
from shepherd_ros.cli import all_verbs, main
from shepherd_ros.cli.train_verbs import DEFAULT_RECIPES
from shepherd_ros.policy.checkpoint import load_policy, read_checkpoint_metadata

NETWORK = (
    '--policy.network.filters-1 2 --policy.network.filters-2 2 --policy.network.hidden 8 '
    '--policy.lidar.n-rays 96'
)
TINY = (
    '--samples 40 --groups 1 --worlds 2 --decisions 4 --eval-episodes 2 --eval-steps 8 '
    '--eval-freq 2 --sheep-min 3 --sheep-max 3 --shepherds-max 2 '
    '--episode-steps 32 --minibatch-size 8'
)
LESSONS = (
    '--rounds 2 --groups 1 --worlds 2 --steps-per-round 8 --teacher-rounds 1 --teacher-groups 0 '
    '--eval-freq 1 --eval-episodes 2 --eval-steps 8 --sheep-min 3 --sheep-max 3 '
    '--shepherds-max 2 --updates-per-round 2 --batch-size 4'
)


def train(words: str, out: Path) -> int:
    """Run a verb of training; return the exit code."""
    return main(['train', *words.split(), '--out', str(out)])


def test_ppo_from_scratch_holds_actions_for_shorter(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert train(f'ppo {NETWORK} {TINY}', tmp_path) == 0
    output = capsys.readouterr().out
    assert output.count('  0:00:00 left\n') >= 1
    assert f'the best policy is in {tmp_path / "best.safetensors"}' in output
    lines = [json.loads(x) for x in (tmp_path / 'curve.jsonl').read_text().splitlines()]
    assert min(line['seconds_left'] for line in lines) == lines[-1]['seconds_left'] == 0
    paces = [line['decision_interval'] for line in lines]
    assert paces[0] == 4.0
    assert paces == sorted(paces, reverse=True)
    assert paces[-1] < 4.0


def test_training_goes_on_from_a_checkpoint_with_what_is_asked_changed(tmp_path: Path) -> None:
    assert train(f'dagger {NETWORK} {LESSONS}', tmp_path / 'a') == 0
    first = tmp_path / 'a' / 'best.safetensors'
    # min-std is what PPO has by default, and is asked for here: the checkpoint has 0.05
    words = f'--pretrained {first} --policy.network.init-std 0.3 --policy.network.min-std 0.2'
    words += ' --actor-learning-rate 0'
    assert train(f'ppo {words} {TINY} --critic-warmup 99', tmp_path / 'b') == 0
    start, end = load_policy(str(first)), load_policy(str(tmp_path / 'b' / 'best.safetensors'))
    assert start.config.network.min_std == 0.05
    assert end.config.network.init_std == 0.3
    assert end.config.network.min_std == 0.2
    assert end.config.network.filters_1 == 2
    assert end.config.decision_interval == start.config.decision_interval == 0.5
    for name, value in start.actor.state_dict().items():
        assert value.equal(end.actor.state_dict()[name]), name
    assert not start.critic.head.weight.equal(end.critic.head.weight)
    _, record, _ = read_checkpoint_metadata(tmp_path / 'b' / 'best.safetensors')
    assert record['config']['pretrained'] == str(first)
    assert record['command'].startswith(f'shepherd train ppo --pretrained {first}')


def test_quick_is_another_recipe_in_which_options_count_as_ever(tmp_path: Path) -> None:
    assert train(f'ppo --quick {NETWORK} {TINY} --home-share 0.5', tmp_path / 'quick') == 0
    assert train(f'ppo {NETWORK} {TINY}', tmp_path / 'usual') == 0
    quick, usual = (
        read_checkpoint_metadata(tmp_path / name / 'best.safetensors')[1]['config']
        for name in ('quick', 'usual')
    )
    assert quick['policy']['observation']['layout'] == 'ring'
    assert usual['policy']['observation']['layout'] != 'ring'
    assert quick['policy']['network']['padding'] == 'circular'
    assert quick['policy']['network']['hidden'] == usual['policy']['network']['hidden'] == 8
    assert quick['run']['samples'] == usual['run']['samples'] == 40
    assert (quick['run']['task']['home_share'], usual['run']['task']['home_share']) == (0.5, 0.0)
    assert quick['run']['task']['goal_radius_max'] == 6.0


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        ('ppo --threads 0', '--threads is 0: expected at least 1'),
        ('ppo --pretrained nowhere', "checkpoint is 'nowhere': expected a .safetensors file"),
        ('ppo --samples 0', r'samples is 0: expected a value in [1, inf]'),
        (
            'ppo --final-decision-interval 1.5',
            'final_decision_interval is 1.5 s: expected a time that halving',
        ),
        ('ppo --policy.decision-interval 3', 'frame_interval is 4.0 s: expected 1 to 1000 times'),
        ('dagger --teacher shepard', "controller is 'shepard': expected one of"),
        ('ppo --sheep-min 200', 'sheep_min is 200: expected at most sheep_max, 100'),
        (
            'ppo --pretrained imitation --policy.network.hidden 3',
            '--pretrained imitation does not fit',
        ),
        ('bc', 'no bags are given: expected'),
    ],
)
def test_a_mistake_is_named_with_a_way_out(
    words: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert train(words, tmp_path) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize('words', ['dagger', 'bc bag'])
def test_what_cannot_share_a_run_refuses_torchrun(
    words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('WORLD_SIZE', '2')
    assert train(words, tmp_path / 'run') == 2
    message = 'torchrun has started 2 processes: expected one, only PPO trains in several'
    assert message in capsys.readouterr().err
    assert not (tmp_path / 'run').exists()


def helped(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Return the help of a command."""
    with suppress(SystemExit):
        assert main([*words, '--help']) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize('name', ['ppo', 'dagger', 'bc'])
def test_help_of_a_training_fits_two_screens_and_lacks_no_option(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv('COLUMNS', '80')
    lines = helped(['train', name], capsys).splitlines()
    assert len(lines) <= 100
    assert max(map(len, lines)) <= 80
    assert main(['train', name, '--help-policy']) == 0
    shown = set(re.findall(r'^  (--[\w.-]+) ', capsys.readouterr().out, re.MULTILINE))
    recipe = DEFAULT_RECIPES[name]
    names = {f'--{path.rpartition(".")[2]}' for path in recipe.run.values()}
    names |= {f'--policy.{path}' for path in recipe.policy.values()}
    names |= {'--out', '--pretrained', '--quick', '--threads', '--device'}
    assert shown == {option.replace('_', '-') for option in names}


def test_help_has_the_defaults_of_the_recipe(capsys: pytest.CaptureFixture[str]) -> None:
    usual, quick = (
        dict(re.findall(r'^  (--[\w.-]+) +(\S+)', helped(words, capsys), re.MULTILINE))
        for words in (['train', 'ppo'], ['train', 'ppo', '--quick'])
    )
    assert (usual['--samples'], quick['--samples']) == ('2000000', '1000000')
    assert (usual['--goal-radius-max'], quick['--goal-radius-max']) == ('8.0', '6.0')
    assert usual['--out'] == 'required'


@pytest.mark.parametrize('columns', ['80', '120'])
def test_help_of_every_verb_fits_two_screens(
    columns: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv('COLUMNS', columns)
    for name in all_verbs():
        assert 0 < len(helped([name], capsys).splitlines()) <= 100, name
    assert 0 < len(helped([], capsys).splitlines()) <= 100
