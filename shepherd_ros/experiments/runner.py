"""Runner of whole episodes of a controller, all worlds in one batch."""

from __future__ import annotations

from collections.abc import Callable

from shepherd_ros.controllers.controller import Controller
from shepherd_ros.sim.rollout import advance, EnvConfig, start
from shepherd_ros.sim.spawn import spawn
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
    moment = start(spawn(config.world, seed + torch.arange(episodes, device=device)), config)
    memory = controller.begin(moment.perceived)
    total = torch.zeros(episodes, device=device)
    for step in range(config.world.episode_steps):
        command, memory = controller.act(moment.perceived, memory)
        moment = advance(moment, command)
        total += moment.reward
        on_step(step + 1)
        if config.world.task.ends and moment.ended.all():
            break
    return {name: v.cpu() for name, v in (moment.metrics() | {'return': total}).items()}
