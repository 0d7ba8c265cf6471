"""A run that is cut off goes on as if it had not been."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.learning.ppo import PPOConfig
from shepherd_ros.learning.run_folder import RunFolder
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.learning.train_ppo import PPORunConfig, train_ppo
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import ObservationConfig
import torch

POLICY = PolicyConfig(
    action_repeat=2,
    lidar=LidarConfig(n_rays=64),
    observation=ObservationConfig(spacing=4, align='goal', unit=10.0),
    network=NetworkConfig(filters_1=2, filters_2=2, hidden=8),
)
CONFIG = PPORunConfig(
    samples=300, groups=2, worlds=2, decisions=6, eval_freq=2, eval_episodes=2, eval_steps=6,
    task=TaskConfig(sheep_min=4, sheep_max=8, shepherds_max=3, episode_steps=20),
    ppo=PPOConfig(minibatch_size=16),
)  # fmt: skip
TIMES = ('seconds', 'seconds_left', 'samples_per_second', 'rollout_share')


class PowerCutError(Exception):
    """Stands for kill -9: nothing is done after it."""


def train(folder: Path, stop_after: int | None = None) -> list[dict[str, Any]]:
    """Train until the end or a power cut; return the curve without times."""
    torch.manual_seed(5)
    policy = Policy(POLICY)
    record = {'config': {'policy': POLICY.to_dict(), 'run': CONFIG.to_dict()}}

    def watch(line: dict[str, Any]) -> None:
        if stop_after is not None and line['updates'] >= stop_after:
            raise PowerCutError

    train_ppo(policy, CONFIG, RunFolder(folder, record), watch)
    lines = (folder / 'curve.jsonl').read_text(encoding='utf-8').splitlines()
    return [{k: v for k, v in json.loads(x).items() if k not in TIMES} for x in lines]


def test_a_run_that_is_cut_off_goes_on_with_the_same_numbers(tmp_path: Path) -> None:
    whole = train(tmp_path / 'whole')
    assert len(whole) >= 6
    for cut in (1, 3, 4):  # before the first state was saved, after it, just when it was
        with pytest.raises(PowerCutError):
            train(tmp_path / 'cut', cut)
    assert train(tmp_path / 'cut') == whole
    names = sorted(
        path.name for path in (tmp_path / 'cut').iterdir() if 'tfevents' not in path.name
    )
    assert names == ['best.safetensors', 'curve.jsonl', 'run.json', 'state.pt']


def test_a_folder_with_another_run_or_a_torn_state_is_refused(tmp_path: Path) -> None:
    RunFolder(tmp_path, {'config': {'seed': 1}})
    with pytest.raises(ConfigError, match='holds a run with another configuration'):
        RunFolder(tmp_path, {'config': {'seed': 2}})
    run = RunFolder(tmp_path, {'config': {'seed': 1}})
    run.state.write_bytes(b'torn')
    with pytest.raises(ConfigError, match=r'state.pt cannot be read .*remove it to start anew'):
        run.load()
