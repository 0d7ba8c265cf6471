"""Whole episodes of the heuristics, and the table made of them."""

from dataclasses import replace
from pathlib import Path

import pytest
from shepherd_ros.cli import main
from shepherd_ros.controllers import make_controller
from shepherd_ros.evaluation.runner import mean_and_interval, run_episodes
from shepherd_ros.sim.env import EnvConfig
from shepherd_ros.sim.world import WorldConfig
import torch


@pytest.mark.parametrize(('name', 'least'), [('strombom', 0.95), ('pierson', 0.99)])
def test_a_heuristic_brings_the_flock_home_on_the_default_world(name: str, least: float) -> None:
    world = WorldConfig()
    result = run_episodes(EnvConfig(world=world), make_controller(name, world), 0, 24)
    assert float(result['fraction_reached'].mean()) >= least
    assert bool(result['completed'].all())


@pytest.mark.parametrize('name', ['idle', 'random'])
def test_a_floor_brings_nobody_home(name: str) -> None:
    world = replace(WorldConfig(), episode_steps=200)
    result = run_episodes(EnvConfig(world=world), make_controller(name, world), 0, 8)
    assert float(result['fraction_reached'].mean()) < 0.3


def test_an_episode_is_the_same_alone_and_among_others() -> None:
    config = EnvConfig(world=replace(WorldConfig(), n_sheep=20, episode_steps=120))
    controller = make_controller('strombom', config.world)
    together = run_episodes(config, controller, 5, 3)
    for k in range(3):
        alone = run_episodes(config, controller, 5 + k, 1)
        for name, values in together.items():
            torch.testing.assert_close(alone[name][0], values[k], atol=1e-5, rtol=1e-5)


def test_mean_and_interval_by_hand() -> None:
    mean, half = mean_and_interval(torch.tensor([1.0, 2.0, 3.0, 4.0]))
    assert mean == 2.5
    assert half == pytest.approx(1.96 * (5 / 3) ** 0.5 / 2)
    assert mean_and_interval(torch.tensor([2.0]))[1] != mean_and_interval(torch.tensor([2.0]))[1]


def test_the_table_has_a_row_for_each_cell(tmp_path: Path) -> None:
    out = tmp_path / 'new' / 'table.md'
    words = ['evaluate', '--shepherds', '1', '2', '--sheep', '3', '--episodes', '2']
    assert main([*words, '--steps', '5', '--out', str(out)]) == 0
    lines = out.read_text().splitlines()
    assert len(lines) == 2 + 4
    assert lines[2].startswith('| 3 | 1 | strombom | 5 ± 0 |')
