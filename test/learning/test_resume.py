"""A run that is cut off goes on as if it had not been, and its folder belongs to it alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import errno
from functools import cache
import json
import os
from pathlib import Path
import signal
from typing import Any

import pytest
from shepherd_ros.config import Config, ConfigError
from shepherd_ros.controllers import make_controller
from shepherd_ros.learning import dagger
from shepherd_ros.learning import train_ppo as ppo_training
from shepherd_ros.learning.clone import CloneConfig
from shepherd_ros.learning.dagger import LabelledWorlds, train_dagger
from shepherd_ros.learning.dagger_config import DaggerConfig
from shepherd_ros.learning.ppo import PPOConfig
from shepherd_ros.learning.run_folder import RunFolder
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.learning.train_bc import BCConfig, train_bc
from shepherd_ros.learning.train_ppo import PPORunConfig, train_ppo
from shepherd_ros.learning.validation import EvaluationConfig
from shepherd_ros.policy.checkpoint import load_policy, read_checkpoint_metadata
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.recordings.record import record_episodes
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import ObservationConfig
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor

LIDAR = LidarConfig(n_rays=64)
POLICY = PolicyConfig(
    decision_interval=1.0,
    lidar=LIDAR,
    observation=ObservationConfig(frame_interval=2.0, align='goal', unit=10.0),
    network=NetworkConfig(filters_1=2, filters_2=2, hidden=8),
)
TASK = TaskConfig(sheep_min=4, sheep_max=8, shepherds_max=3, episode_steps=20)
CLONE = CloneConfig(batch_size=8, updates_per_round=3)
EVALUATION = EvaluationConfig(eval_episodes=2, eval_steps=6)
CONFIGS: dict[str, Config] = {
    'ppo': PPORunConfig(
        samples=300, groups=2, worlds=2, decisions=6, eval_freq=2, evaluation=EVALUATION,
        task=TASK, ppo=PPOConfig(minibatch_size=16),
    ),
    'dagger': DaggerConfig(
        rounds=6, teacher_rounds=2, steps_per_round=7, example_interval=2, groups=2, worlds=2,
        buffer_size=90, eval_freq=3, evaluation=EVALUATION, task=TASK, clone=CLONE,
    ),
    'bc': BCConfig(
        epochs=3, buffer_size=50, evaluation=EVALUATION, task=TASK, clone=CLONE
    ),
}  # fmt: skip
KINDS = sorted(CONFIGS)
TIMES = ('seconds', 'seconds_left', 'samples_per_second', 'rollout_share')
Line = dict[str, Any]
Whole = tuple[Path, list[Line]]
pytestmark = pytest.mark.xdist_group('resume')  # whole runs for all


class PowerCutError(Exception):
    """Stands for kill -9: nothing is done after it."""


@pytest.fixture(scope='module')
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out, world = tmp_path_factory.mktemp('bags'), WorldConfig(5, 2, episode_steps=20)
    config = EnvConfig(world=world, lidar=LIDAR)
    record_episodes(config, make_controller('drover', world), range(3), out)
    return out


def learn(
    kind: str, folder: Path, bags: Path, watch: Callable[[Line], None] = bool, **changes: Any
) -> list[Line]:
    """Train until the end or until watch() raises; return the curve without times."""
    torch.manual_seed(5)
    policy, config = Policy(POLICY), replace(CONFIGS[kind], **changes)
    run = RunFolder(folder, {'config': {'policy': POLICY, 'run': config}})
    if isinstance(config, PPORunConfig):
        train_ppo(policy, config, run, watch)
    elif isinstance(config, DaggerConfig):
        train_dagger(policy, config, run, watch)
    else:
        train_bc(policy, [bags], config, run, watch)
    lines = (folder / 'curve.jsonl').read_text(encoding='utf-8').splitlines()
    return [{k: v for k, v in json.loads(x).items() if k not in TIMES} for x in lines]


@pytest.fixture(scope='module')
def whole(tmp_path_factory: pytest.TempPathFactory, bags: Path) -> Callable[[str], Whole]:
    """Return what trains from beginning to end: the folder and the curve, once for each kind."""

    @cache
    def trained(kind: str) -> Whole:
        folder = tmp_path_factory.mktemp(kind) / 'run'
        return folder, learn(kind, folder, bags)

    return trained


def cut_after(update: int, number: int = 0) -> Callable[[Line], None]:
    """Return what cuts a run off after an update: a power cut, or a signal."""

    def watch(line: Line) -> None:
        if line['updates'] == update and number:
            os.kill(os.getpid(), number)
        elif line['updates'] == update:
            raise PowerCutError

    return watch


def test_bags_of_a_lidar_with_another_range_are_refused(tmp_path: Path) -> None:
    world = WorldConfig(5, 1, episode_steps=20)
    other = EnvConfig(world=world, lidar=replace(LIDAR, range_max=30.0))
    record_episodes(other, make_controller('drover', world), range(1), tmp_path / 'bags')
    with pytest.raises(ConfigError, match=r'30\.0 m, expected 75\.0 m'):
        learn('bc', tmp_path / 'run', tmp_path / 'bags')


@pytest.mark.parametrize('kind', KINDS)
def test_a_run_that_is_cut_off_goes_on_with_the_same_numbers(
    kind: str, tmp_path: Path, bags: Path, whole: Callable[[str], Whole]
) -> None:
    (folder, curve), cut = whole(kind), tmp_path / 'cut'
    updates = len(curve)
    assert updates >= 3
    for update in sorted({1, 2, updates - 1}):
        with pytest.raises(PowerCutError):
            learn(kind, cut, bags, cut_after(update))
    assert learn(kind, cut, bags) == curve
    assert learn(kind, cut, bags) == curve  # and is over
    names = {path.name for path in cut.iterdir() if 'tfevents' not in path.name}
    assert names == {'best.safetensors', 'curve.jsonl', 'lock', 'run.json', 'state.pt'}
    other = load_policy(str(folder / 'best.safetensors')).state_dict()
    for name, weight in load_policy(str(cut / 'best.safetensors')).state_dict().items():
        assert torch.equal(weight, other[name])


@pytest.mark.parametrize('kind', KINDS)
def test_signals_save_the_state_and_end_with_their_exit_code(
    kind: str, tmp_path: Path, bags: Path, whole: Callable[[str], Whole]
) -> None:
    cut, last = tmp_path / 'cut', {'ppo': 2}.get(kind, 1)  # no evaluation, which saves, is next
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        learn(kind, cut, bags, cut_after(last, signal.SIGINT))
    stored = torch.load(cut / 'state.pt', weights_only=True)
    done = last if kind == 'bc' else last + 1  # cloning stops within an epoch
    assert [state['progress']['updates'] for state in stored['ranks']] == [done]
    seen: list[Line] = []

    def watch(line: Line) -> None:
        if not seen:
            os.kill(os.getpid(), signal.SIGTERM)
        seen.append(line)

    with pytest.raises(SystemExit) as ended:
        learn(kind, cut, bags, watch)
    assert ended.value.code == 128 + signal.SIGTERM
    # the update that ran as the signal came is done, only its evaluation may be left
    assert seen[0]['updates'] == last + 1
    assert learn(kind, cut, bags) == whole(kind)[1]
    assert signal.getsignal(signal.SIGINT) == before


def test_ctrl_c_in_an_evaluation_ends_at_once_and_the_line_comes_later(
    tmp_path: Path,
    bags: Path,
    whole: Callable[[str], Whole],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def validate(*arguments: Any) -> dict[str, float]:
        os.kill(os.getpid(), signal.SIGINT)
        return {}

    with monkeypatch.context() as patch:
        patch.setattr(ppo_training, 'validate', validate)
        with pytest.raises(KeyboardInterrupt):
            learn('ppo', tmp_path / 'cut', bags)
    assert len((tmp_path / 'cut' / 'curve.jsonl').read_text().splitlines()) == 1
    assert learn('ppo', tmp_path / 'cut', bags) == whole('ppo')[1]


def test_what_is_torn_between_state_and_curve_is_written_again(
    tmp_path: Path,
    bags: Path,
    whole: Callable[[str], Whole],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cut = tmp_path / 'cut'
    write = RunFolder.write

    def dies(run: RunFolder, line: Line) -> None:
        if line['updates'] == 4:
            with run.curve.open('a') as file:
                file.write('{"updates": 4, "samp')
            raise PowerCutError
        write(run, line)

    with monkeypatch.context() as patch:
        patch.setattr(RunFolder, 'write', dies)
        with pytest.raises(PowerCutError):
            learn('ppo', cut, bags)
    assert learn('ppo', cut, bags) == whole('ppo')[1]


@pytest.mark.parametrize(('kind', 'more'), [('ppo', 'samples'), ('dagger', 'rounds')])
def test_a_run_may_be_given_more_but_not_less(
    kind: str, more: str, tmp_path: Path, bags: Path
) -> None:
    first = learn(kind, tmp_path, bags)
    longer = getattr(CONFIGS[kind], more) * 3 // 2
    curve = learn(kind, tmp_path, bags, **{more: longer})
    assert curve[: len(first)] == first
    assert len(curve) > len(first)
    assert json.loads((tmp_path / 'run.json').read_text())['config']['run'][more] == longer
    with pytest.raises(ConfigError, match='holds a run with another configuration'):
        learn(kind, tmp_path, bags)


def test_the_best_is_not_replaced_by_a_worse_one_even_after_the_state_is_lost(
    tmp_path: Path, bags: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    learn('dagger', tmp_path, bags)
    best = read_checkpoint_metadata(tmp_path / 'best.safetensors')[1]['eval']
    (tmp_path / 'state.pt').unlink()
    worse = {name: value - 1 for name, value in best.items()}
    monkeypatch.setattr(dagger, 'validate', lambda *arguments: worse)
    learn('dagger', tmp_path, bags)
    assert read_checkpoint_metadata(tmp_path / 'best.safetensors')[1]['eval'] == best


def test_each_evaluation_keeps_its_policy_also_in_a_run_that_goes_on(
    tmp_path: Path, bags: Path
) -> None:
    keeps = replace(EVALUATION, keep_evaluated=True)
    curve = learn('ppo', tmp_path / 'whole', bags, evaluation=keeps)
    with pytest.raises(PowerCutError):
        learn('ppo', tmp_path / 'cut', bags, cut_after(3), evaluation=keeps)
    learn('ppo', tmp_path / 'cut', bags, evaluation=keeps)
    evaluated = [line for line in curve if 'eval/score' in line]
    names = [f'{int(line["updates"]):06d}.safetensors' for line in evaluated]
    assert len(names) > 1
    one, other = (tmp_path / name / 'evaluated' for name in ('whole', 'cut'))
    for folder in (one, other):
        assert sorted(path.name for path in folder.iterdir()) == names
    for name, line in zip(names, evaluated, strict=True):
        weights = load_policy(str(other / name)).state_dict()
        for key, weight in load_policy(str(one / name)).state_dict().items():
            assert torch.equal(weight, weights[key])
        assert read_checkpoint_metadata(one / name)[1]['eval']['score'] == line['eval/score']


def test_a_second_process_is_refused(tmp_path: Path, bags: Path) -> None:
    def second(line: Line) -> None:
        with pytest.raises(ConfigError, match='is in use: expected one training at a time'):
            learn('bc', tmp_path, bags)

    learn('bc', tmp_path, bags, second)


def test_a_folder_that_cannot_be_used_is_told(tmp_path: Path, bags: Path) -> None:
    RunFolder(tmp_path, {'config': {'seed': 1}})
    with pytest.raises(ConfigError, match='holds a run with another configuration'):
        RunFolder(tmp_path, {'config': {'seed': 2}})
    (tmp_path / 'run.json').write_text('')
    with pytest.raises(ConfigError, match=r'run.json cannot be read .*remove the folder'):
        RunFolder(tmp_path, {'config': {'seed': 1}})
    with pytest.raises(ConfigError, match=r'run.json cannot be written .*expected a folder'):
        RunFolder(tmp_path / 'run.json', {'config': {'seed': 1}})
    folder = tmp_path / 'run'
    learn('ppo', folder, bags)
    stored = torch.load(folder / 'state.pt', weights_only=True)
    rollout = stored['ranks'][0]['rollout'] | {'generator': torch.zeros(16, dtype=torch.uint8)}
    gpu = stored | {'ranks': [stored['ranks'][0] | {'rollout': rollout}]}
    for other in (b'torn', {'a': 1}, gpu, stored | {'ranks': stored['ranks'] * 2}):
        if isinstance(other, bytes):
            (folder / 'state.pt').write_bytes(other)
        else:
            torch.save(other, folder / 'state.pt')
        with pytest.raises(ConfigError, match=r'state.pt cannot be read .*remove it to start'):
            learn('ppo', folder, bags)
    torch.save(stored, folder / 'state.pt')
    (folder / 'curve.jsonl').unlink()
    with pytest.raises(ConfigError, match=r'curve.jsonl has 0 lines: expected'):
        learn('ppo', folder, bags)


@pytest.mark.parametrize('name', ['run.json', 'state.pt', 'best.safetensors'])
def test_a_full_disk_is_told_and_leaves_what_was_there(
    name: str,
    tmp_path: Path,
    bags: Path,
    whole: Callable[[str], Whole],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cut = tmp_path / 'cut'
    if name != 'run.json':  # which is written first
        with pytest.raises(PowerCutError):
            learn('ppo', cut, bags, cut_after(2))
    replaced = Path.replace

    def full(path: Path, target: Path) -> Path:
        if Path(target).name == name:
            raise OSError(errno.ENOSPC, 'No space left on device')
        return replaced(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, 'replace', full)
        patch.setattr(ppo_training, 'validate', lambda *arguments: {'score': 1e9})
        with pytest.raises(ConfigError, match=rf'{name} cannot be written .*No space') as failure:
            learn('ppo', cut, bags)
    assert learn('ppo', cut, bags) == whole('ppo')[1]
    assert failure.tb is not None, 'it was alive, and did not hold the lock'


def test_a_learner_that_is_broken_is_told_and_not_kept(tmp_path: Path, bags: Path) -> None:
    """A rate at which weights overflow."""
    config = replace(CONFIGS['ppo'].ppo, actor_learning_rate=1e30)  # type: ignore[attr-defined]
    with pytest.raises(ConfigError, match=r'is not finite after update 1: .*learning rates'):
        learn('ppo', tmp_path, bags, ppo=config)
    assert not (tmp_path / 'best.safetensors').exists()
    assert not (tmp_path / 'curve.jsonl').exists()


def test_one_decision_is_enough_for_finite_weights(tmp_path: Path, bags: Path) -> None:
    task = replace(TASK, shepherds_max=1)
    small = {'samples': 4, 'groups': 1, 'worlds': 1, 'decisions': 1, 'task': task}
    assert len(learn('ppo', tmp_path, bags, **small)) == 4
    load_policy(str(tmp_path / 'best.safetensors'))


def test_labels_are_of_the_step_of_their_frames_when_actions_are_held() -> None:
    policy = Policy(
        replace(POLICY, decision_interval=2.0, observation=ObservationConfig(frame_interval=2.0))
    )
    config = DaggerConfig(task=TASK, worlds=2, groups=1, example_interval=1)
    worlds = LabelledWorlds(config, policy, 0, torch.float32)
    newest: list[tuple[Tensor, Tensor]] = []

    class Kept:
        def add(self, frames: Tensor, *columns: Tensor) -> None:
            now = worlds.group.moment
            present = now.state.shepherd_mask
            newest.append((frames[:, -1], policy.scale(now.ranges[present])))

    worlds.run(10, False, Kept())  # type: ignore[arg-type]
    assert len(newest) == 3  # steps 0, 4 and 8
    assert all(torch.equal(seen, existing) for seen, existing in newest)
