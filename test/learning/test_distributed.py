"""Processes that train together take the steps that one with all their worlds would take."""

from __future__ import annotations

import json
from pathlib import Path
import signal
import subprocess
import sys
from typing import Any

from forks import TORCHRUN
import pytest
from shepherd_ros.cli import main
from shepherd_ros.learning.distributed import rank, ranks
from shepherd_ros.learning.ppo import PPOConfig, PPOLearner
from shepherd_ros.learning.ppo_rollout import Batch
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import input_shape, ObservationConfig
import torch
from torch import Tensor

COUNT, FIRST = 60, 44  # decisions, and how many of them the first of two processes has
NETWORK = PolicyConfig(
    lidar=LidarConfig(n_rays=64),
    observation=ObservationConfig(frame_interval=2.0),
    network=NetworkConfig(filters_1=2, filters_2=2, hidden=8),
)
TINY = (
    '--policy.lidar.n-rays 64 --policy.network.filters-1 2 --policy.network.filters-2 2 '
    '--policy.network.hidden 4 --groups 2 --worlds 2 --decisions 4 --minibatch-size 16 '
    '--samples 400 --eval-freq 3 --eval-episodes 2 --eval-steps 6 --sheep-min 3 '
    '--sheep-max 5 --shepherds-max 2 --episode-steps 48'
)

pytestmark = [
    pytest.mark.system,
    pytest.mark.xdist_group('distributed'),  # one training for all
]
TIMES = ('seconds', 'seconds_left', 'samples_per_second', 'rollout_share')


class Inputs:
    """Stands for the store of a rollout: the inputs of decisions by their number."""

    def __init__(self, x: Tensor) -> None:
        self.x = x

    def inputs(self, rows: Tensor, first: Tensor) -> Tensor:
        return self.x[rows[:, 0]]


def updated() -> dict[str, Tensor]:
    """Return the weights after an update from this process's part of a fixed batch."""
    torch.manual_seed(0)
    policy = Policy(NETWORK)
    x = torch.rand(COUNT, *input_shape(NETWORK.observation, 64))
    with torch.no_grad():
        mean, std = policy.actor(x)
    action = mean + std * torch.randn(COUNT, 2)
    density = (-0.5 * ((action - mean) / std).square() - std.log()).sum(dim=-1)
    value, gain = torch.randn(COUNT), torch.randn(COUNT) + 0.5
    own = torch.arange(COUNT)
    if ranks() == 2:
        own = own[:FIRST] if rank() == 0 else own[FIRST:]
    batch = Batch(
        own[:, None],
        torch.zeros_like(own),
        action[own],
        density[own],
        value[own],
        gain[own],
        hold=None,
    )
    config = PPOConfig(
        update_epochs=3,
        minibatch_size=1000,
        actor_learning_rate=1e-2,
        critic_learning_rate=1e-2,
        target_kl=9.0,
    )
    learner = PPOLearner(policy, config)
    before = {k: v.clone() for k, v in policy.state_dict().items()}
    store: Any = Inputs(x)
    learner.update(store, batch, torch.Generator().manual_seed(3))
    after = policy.state_dict()
    assert max(float((after[k] - before[k]).abs().max()) for k in after) > 0.01
    return dict(after)


def torchrun(commands: Path, name: str, *words: object) -> subprocess.Popen[str]:
    """Start two processes of a command, as the program `torchrun` does."""
    command = [str(word) for word in (commands / 'python', *TORCHRUN, commands / name, *words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def train_ppo(commands: Path, out: Path) -> str:
    """Return what two processes print that train to the end."""
    run = torchrun(commands, 'shepherd', 'train', 'ppo', *TINY.split(), '--out', out)
    printed, errors = run.communicate()
    assert run.returncode == 0, errors
    return printed


def test_an_update_of_two_is_that_of_one_with_all_decisions(
    commands: Path, tmp_path: Path
) -> None:
    run = torchrun(commands, 'python', __file__, tmp_path)
    _, errors = run.communicate()
    assert run.returncode == 0, errors
    one = updated()
    for index in (0, 1):
        two = torch.load(tmp_path / f'{index}.pt', weights_only=True)
        for name, value in one.items():
            # of steps that are a hundred times as long
            torch.testing.assert_close(two[name], value, atol=1e-4, rtol=0, msg=name)


@pytest.fixture(scope='module')
def trained(commands: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp('ranks') / 'run'
    assert train_ppo(commands, out).count('the best policy is in') == 1
    return out


def test_two_have_the_same_weights_and_worlds_of_their_own(trained: Path) -> None:
    states = torch.load(trained / 'state.pt', weights_only=True)['ranks']
    one, other = (state['learner']['policy'] for state in states)
    assert all(torch.equal(one[name], other[name]) for name in one)
    seeds = [{int(s) for g in k['rollout']['groups'] for s in g['state']['seed']} for k in states]
    assert seeds[0].isdisjoint(seeds[1])
    curve = [json.loads(line) for line in (trained / 'curve.jsonl').read_text().splitlines()]
    # 2 processes, 2 groups, 2 worlds, 4 decisions, of steps that are held as long as told
    assert [c['world_steps'] for c in curve[:2]] == [32 * 8, 64 * 8]
    assert curve[-1]['samples'] >= 400


def test_a_run_of_two_that_is_ended_goes_on_as_if_it_had_not_been(
    trained: Path, commands: Path, tmp_path: Path
) -> None:
    out = tmp_path / 'run'
    run = torchrun(commands, 'shepherd', 'train', 'ppo', *TINY.split(), '--out', out)
    assert run.stdout is not None
    for _ in range(4):  # the first evaluation is over
        run.stdout.readline()
    run.send_signal(signal.SIGTERM)
    run.communicate()
    assert run.returncode != 0
    assert len(torch.load(out / 'state.pt', weights_only=True)['ranks']) == 2
    train_ppo(commands, out)
    curves = [
        [
            {name: value for name, value in json.loads(line).items() if name not in TIMES}
            for line in (folder / 'curve.jsonl').read_text().splitlines()
        ]
        for folder in (out, trained)
    ]
    assert curves[0] == curves[1]


def test_a_state_of_another_number_of_processes_is_refused(
    trained: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['train', 'ppo', *TINY.split(), '--out', str(trained)]) == 2
    output = capsys.readouterr().err
    assert '2 processes, expected 1' in output
    assert 'remove it to start anew' in output


if __name__ == '__main__':
    torch.save(updated(), Path(sys.argv[1]) / f'{rank()}.pt')
