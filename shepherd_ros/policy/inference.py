"""Inference of a policy within an episode: memory of scans, and decisions every few steps."""

from __future__ import annotations

from collections.abc import Callable

from shepherd_ros.policy.policy import Policy
from shepherd_ros.policy.timing import Timing
from shepherd_ros.sim.frames import Frames
from shepherd_ros.sim.vectors import clip_norm
import torch
from torch import Tensor

PolicyMemory = dict[str, Tensor]


def begin(
    policy: Policy,
    timing: Timing,
    batch: tuple[int, ...],
    team: int,
    dtype: torch.dtype = torch.float32,
) -> PolicyMemory:
    """Return the memory of teams (*batch, team) before their first scan; dtype as for act()."""
    config, device = policy.config, policy.device
    shape = (*batch, team, timing.frames.window, *config.lidar.layout.shape)
    return {
        'count': torch.zeros(batch, dtype=torch.int64, device=device),  # steps since then
        'history': torch.zeros(shape, dtype=dtype, device=device),  # scaled, newest last
        # ray in front of the newest
        'first': torch.zeros(*batch, team, dtype=torch.int64, device=device),
        'command': torch.zeros(*batch, team, 2, device=device),
    }


def act(
    policy: Policy,
    timing: Timing,
    read_ranges: Callable[[], Tensor],
    present: Tensor,
    memory: PolicyMemory,
    top_speed: float,
    draws: Callable[[], Tensor] | None = None,
    skipped: int = 0,
    std: float = 0.0,
) -> tuple[Tensor, PolicyMemory]:
    """
    Return commands (..., H, 2) m/s, world frame, at most top_speed [m/s], and memory.

    read_ranges() returns the ranges (..., H, C, R) m of this step and is called at decisions only;
    between them commands are held. present (..., H) bool marks the shepherds that act; the others
    keep their command, zero at first. draws() returns standard normal numbers (..., H, 2) for
    sampled actions; None: the mean. std [m/s] takes the place of the policy's own spread unless it
    is 0. skipped is the number of steps since the last call that were
    not seen; a decision that was due in them is made now.
    """
    repeat, count = timing.action_repeat, memory['count'] + skipped
    decides = count // repeat > (memory['count'] - 1) // repeat
    if not decides.any():
        return memory['command'], memory | {'count': count + 1}
    ranges = read_ranges()
    history, first = _updated_history(policy, timing.frames, memory, ranges, decides)
    acting = (present & decides[..., None]).reshape(-1)
    frames = timing.frames.select(history).flatten(0, -4)[acting]
    numbers = None if draws is None else draws().reshape(-1, 2)[acting]
    command = memory['command'].clone()
    action = policy.act_on(frames, first.reshape(-1)[acting], numbers, std)
    chosen = clip_norm(action, top_speed)
    command.view(-1, 2)[acting] = chosen
    return command, {'count': count + 1, 'history': history, 'first': first, 'command': command}


def _updated_history(
    policy: Policy, frames: Frames, memory: PolicyMemory, ranges: Tensor, decides: Tensor
) -> tuple[Tensor, Tensor]:
    """Return history and first ray with a reading added; the first one fills the history."""
    last = memory['history']
    newest = policy.scale(ranges).to(last.dtype)
    history, first = frames.push(last, newest), policy.first_ray(ranges)
    if not decides.all():
        history = torch.where(decides[(..., *(None,) * 4)], history, last)
        first = torch.where(decides[..., None], first, memory['first'])
    return frames.restart(history, newest, memory['count'] == 0), first
