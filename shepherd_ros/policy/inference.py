"""Inference of a policy within an episode: memory of scans, and decisions every few steps."""

from __future__ import annotations

from collections.abc import Callable

from shepherd_ros.policy.policy import Policy
from shepherd_ros.sim.vectors import clip_norm
import torch
from torch import Tensor

PolicyMemory = dict[str, Tensor]


def begin(
    policy: Policy, batch: tuple[int, ...], team: int, dtype: torch.dtype = torch.float32
) -> PolicyMemory:
    """Return the memory of teams (*batch, team) before their first scan; dtype as for act()."""
    config, device = policy.config, policy.device
    shape = (*batch, team, config.frames.window, *config.lidar.layout.shape)
    return {
        'count': torch.zeros(batch, dtype=torch.int64, device=device),  # steps since then
        'history': torch.zeros(shape, dtype=dtype, device=device),  # scaled, newest last
        # ray in front of the newest
        'first': torch.zeros(*batch, team, dtype=torch.int64, device=device),
        'command': torch.zeros(*batch, team, 2, device=device),
    }


def act(
    policy: Policy,
    read_ranges: Callable[[], Tensor],
    present: Tensor,
    memory: PolicyMemory,
    top_speed: float,
    draws: Callable[[], Tensor] | None = None,
) -> tuple[Tensor, PolicyMemory]:
    """
    Return commands (..., H, 2) m/s, world frame, at most top_speed [m/s], and memory.

    read_ranges() returns the ranges (..., H, C, R) m of this step and is called at decisions only;
    between them commands are held. present (..., H) bool marks the shepherds that act; the others
    keep their command, zero at first. draws() returns standard normal numbers (..., H, 2) for
    sampled actions; None: the mean.
    """
    config, count = policy.config, memory['count']
    decides = count % config.action_repeat == 0
    if not decides.any():
        return memory['command'], memory | {'count': count + 1}
    ranges = read_ranges()
    history, first = _updated_history(policy, memory, ranges, decides)
    acting = (present & decides[..., None]).reshape(-1)
    frames = config.frames.select(history).flatten(0, -4)[acting]
    numbers = None if draws is None else draws().reshape(-1, 2)[acting]
    command = memory['command'].clone()
    chosen = clip_norm(policy.act_on(frames, first.reshape(-1)[acting], numbers), top_speed)
    command.view(-1, 2)[acting] = chosen
    return command, {'count': count + 1, 'history': history, 'first': first, 'command': command}


def _updated_history(
    policy: Policy, memory: PolicyMemory, ranges: Tensor, decides: Tensor
) -> tuple[Tensor, Tensor]:
    """Return history and first ray with a reading added; the first one fills the history."""
    last, frames = memory['history'], policy.config.frames
    newest = policy.scale(ranges).to(last.dtype)
    history, first = frames.push(last, newest), policy.first_ray(ranges)
    if not decides.all():
        history = torch.where(decides[(..., *(None,) * 4)], history, last)
        first = torch.where(decides[..., None], first, memory['first'])
    return frames.restart(history, newest, memory['count'] == 0), first
