"""Run whole episodes of a controller, as many worlds at a time as fit."""

from __future__ import annotations

from collections.abc import Callable

from shepherd_ros.controllers.base import Controller
from shepherd_ros.sim.env import EnvConfig, ShepherdEnv
import torch
from torch import Tensor


def run_episodes(
    config: EnvConfig,
    controller: Controller,
    seed: int,
    episodes: int,
    on_step: Callable[[int], None] = lambda step: None,
    device: str = 'cpu',
) -> dict[str, Tensor]:
    """
    Return the metrics of the episodes with seeds seed .. seed + episodes - 1, (episodes,) each.

    `return` is the sum of the rewards of an episode.

    on_step(step) is called after each step of all worlds.
    """
    env = ShepherdEnv(config, episodes, lidar=False, device=device)
    env.reset(seed)
    memory = controller.begin(env.perceived)
    result: dict[str, Tensor] = {}
    total = torch.zeros(episodes, device=device)
    for step in range(config.world.episode_steps):
        command, memory = controller.act(env.perceived, memory)
        _, reward, _, _, info = env.step(command)
        total += reward
        result = info.get('final_metrics', result)
        on_step(step + 1)
    return {name: values.cpu() for name, values in (result | {'return': total}).items()}


def mean_and_interval(values: Tensor) -> tuple[float, float]:
    """Return mean and half the 95 % interval of (E,) values; NaN for a single one."""
    values = values.double()
    half = (
        1.96 * values.std() / values.shape[0] ** 0.5
        if len(values) > 1
        else torch.tensor(torch.nan)
    )
    return float(values.mean()), float(half)
