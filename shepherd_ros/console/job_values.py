"""The job of the console that maps the values of a critic, state after state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import json
import sys
from typing import Any

import numpy as np
from shepherd_ros.config import ConfigError
from shepherd_ros.experiments.methods import loaded
from shepherd_ros.experiments.value_map import has_critic, place_values, places_around
from shepherd_ros.sim.state import WorldState
import torch


def map_states(request: Mapping[str, Any], say: Callable[..., None]) -> None:
    """
    Map each state that comes as a line, until no more come; say(**content) tells of it.

    Raises ConfigError for a checkpoint without a trained critic.
    """
    import torch

    torch.set_num_threads(1)
    name, h = request['checkpoint'], request['shepherd']
    policy = loaded(name)
    if not has_critic(f'policy:{name}'):
        raise ConfigError(
            f'checkpoint is {name!r}, whose critic has learned nothing: expected a policy that '
            'PPO has trained with a critic of scans, such as strombom'
        )
    say(text='ready')
    for line in sys.stdin:
        moment = json.loads(line)
        state = _state(moment)
        xs, ys = places_around(state)
        values = place_values(policy, state, h, xs, ys).double().numpy()
        say(
            step=moment['step'],
            x=[float(xs[0]), float(xs[-1])],
            y=[float(ys[0]), float(ys[-1])],
            values=np.round(values, 5).tolist(),
        )


def _state(moment: Mapping[str, Any]) -> WorldState:
    """Return a state of the world, a batch of one."""

    def tensor(name: str) -> torch.Tensor:
        return torch.tensor(moment[name], dtype=torch.float32)[None]

    sheep, shepherds = tensor('sheep'), tensor('shepherds')
    return WorldState(
        seed=torch.zeros(1, dtype=torch.int64),
        step=torch.tensor([moment['step']]),
        sheep=sheep,
        heading=torch.zeros_like(sheep),
        sheep_mask=torch.ones(sheep.shape[:2], dtype=torch.bool),
        shepherds=shepherds,
        shepherd_mask=torch.ones(shepherds.shape[:2], dtype=torch.bool),
        goal=tensor('goal'),
        goal_radius=tensor('goal_radius'),
    )
