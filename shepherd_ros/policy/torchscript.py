"""The actor for programs that know neither this package nor its kernels."""

from __future__ import annotations

from pathlib import Path

from shepherd_ros.policy.policy import Policy
from shepherd_ros.sim.observation import turned
import torch
from torch import nn, Tensor


class PlainActor(nn.Module):
    """Frames (n, K, C, R) m, +inf on free rays, to mean velocities (n, 2) m/s, world frame."""

    def __init__(self, policy: Policy) -> None:
        """Take the weights of a policy."""
        super().__init__()
        self.policy = policy

    def forward(self, frames: Tensor) -> Tensor:
        """Return the velocities, not cut to the top speed."""
        first = self.policy.first_ray(frames[:, -1])
        x = self.policy.arranged(self.policy.scaled(frames), first)
        actor = self.policy.actor
        out = actor.head(actor.body.plain(x))
        return turned(out[:, :2], first, frames.shape[-1])


def export_actor(policy: Policy, path: Path) -> float:
    """Write the actor as TorchScript; return its largest difference from the policy [m/s]."""
    shape = (2, policy.config.observation.n_frames, *policy.config.lidar.layout.shape)
    generator = torch.Generator().manual_seed(0)

    def readings(count: int) -> Tensor:
        frames = 40 * torch.rand(count, *shape[1:], generator=generator)
        return torch.where(frames < 20, frames, torch.inf)

    with torch.no_grad():
        traced = torch.jit.trace(PlainActor(policy), readings(2))
        path.parent.mkdir(parents=True, exist_ok=True)
        traced.save(str(path))
        back = torch.jit.load(str(path))
        frames = readings(7)  # another size than it was traced with
        return float((back(frames) - policy.act(frames)).abs().max())
