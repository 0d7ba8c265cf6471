"""A policy within an episode: what it remembers of its scans, and when it decides."""

from __future__ import annotations

from collections.abc import Callable

from shepherd_ros.policy.policy import Policy
from shepherd_ros.sim.observation import first_stack, push_frame
from shepherd_ros.sim.vectors import clip_norm
import torch
from torch import Tensor

Memory = dict[str, Tensor]


def begin(policy: Policy, batch: tuple[int, ...], team: int) -> Memory:
    """Return the memory of teams (*batch, team) that have seen nothing."""
    config = policy.config
    return {
        'count': torch.zeros(batch, dtype=torch.int64),  # steps since then
        'history': torch.zeros(*batch, team, config.history, 3, config.lidar.n_rays),
        'command': torch.zeros(*batch, team, 2),
    }


def fly(
    policy: Policy,
    look: Callable[[], Tensor],
    present: Tensor,
    memory: Memory,
    top_speed: float,
    draws: Callable[[], Tensor] | None = None,
    dtype: torch.dtype = torch.float32,
) -> tuple[Tensor, Memory]:
    """
    Return commands (..., H, 2) m/s, world frame, at most top_speed [m/s]; and memory.

    look() returns the ranges (..., H, 3, R) m of this step and is called where it is time to
    decide; between decisions commands are held. present (..., H) bool are those who act; the
    others keep their command, zero at first. draws() returns standard normal numbers
    (..., H, 2) for sampled actions; None: the mean.
    """
    config, count = policy.config, memory['count']
    due = count % config.repeat == 0
    if not due.any():
        return memory['command'], memory | {'count': count + 1}
    ranges = look()
    history = _remembered(memory, ranges, due)
    acting = (present & due[..., None]).reshape(-1)
    frames = history.flatten(0, -4)[acting][:, :: config.decisions_apart]
    numbers = None if draws is None else draws().reshape(-1, 2)[acting]
    command = memory['command'].clone()
    chosen = clip_norm(policy.act(frames, numbers, dtype), top_speed)
    command.view(-1, 2)[acting] = chosen
    return command, {'count': count + 1, 'history': history, 'command': command}


def _remembered(memory: Memory, ranges: Tensor, due: Tensor) -> Tensor:
    """Return the history with a reading, which fills it all if it is the first."""
    old, first = memory['history'], memory['count'] == 0
    fresh = first_stack(ranges, old.shape[-3])
    pushed = push_frame(old, ranges)
    wide = (..., *(None,) * 4)
    return torch.where(first[wide], fresh, torch.where(due[wide], pushed, old))
