"""A whole stack in one process: many times faster than real time, with all its topics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from shepherd_ros.bringup import stack_in
from shepherd_ros.experiments.setting_arguments import OneSetting
from shepherd_ros.nodes.compose import compose
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.ros.runtime import run
import torch


@dataclass(kw_only=True)
class HerdOptions(OneSetting):
    """
    Run flock_sim, lidars, metrics and a controller as one process.

    The nodes are those of separate processes, with their names, topics and parameters; what only
    they hear does not go through DDS. Their own parameters come from --ros-args --params-file.
    """

    controller: str = 'policy'
    """Controller that commands, or policy:CHECKPOINT; a wrong name shows all of them."""
    mux: bool = False
    """Let one of several sources command each shepherd: the controller, keys, a joystick."""
    standby: tuple[str, ...] = ()
    """With mux: other controllers to switch to."""
    mode: Literal['lockstep', 'realtime'] = 'lockstep'
    """How the world advances."""
    rate: float = 0.0
    """Realtime: steps per second of wall time; 0: 1/dt."""
    seed: int = 0
    """Seed of the first episode."""
    episodes: int = 0
    """Episodes to run; 0: without end."""
    wait_for_scans: bool = True
    """Lockstep: wait until every shepherd has been scanned, so that no scan is ever missed."""


def herd(options: HerdOptions) -> list[ShepherdNode]:
    """Return the nodes, flock_sim first."""
    torch.set_num_threads(1)
    stack = stack_in(
        options.setting,
        options.controller,
        mux=options.mux,
        standby=options.standby,
        mode=options.mode,
        rate=options.rate,
        seed=options.seed,
        episodes=options.episodes,
        wait_for_scans=options.wait_for_scans,
    )
    return compose(stack, use_global_arguments=True)


def main() -> int:
    """Run a whole stack as one process."""
    return run(herd, 'herd', main.__doc__ or '', HerdOptions)
