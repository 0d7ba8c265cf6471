"""Export of the actor, as ONNX or TorchScript, for programs without this package."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from shepherd_ros.config import ConfigError
from shepherd_ros.policy.policy import Policy
from shepherd_ros.sim.observation import rotate_by_ray
import torch
from torch import nn, Tensor


class PlainActor(nn.Module):
    """Frames (n, K, C, R) m, +inf on free rays, to mean velocities (n, 2) m/s, world frame."""

    def __init__(self, policy: Policy) -> None:
        """Use the weights of a policy."""
        super().__init__()
        self.policy = policy

    def forward(self, frames: Tensor) -> Tensor:
        """Return the velocities (n, 2) m/s, not cut to the top speed."""
        first = self.policy.first_ray(frames[:, -1])
        x = self.policy.arrange(self.policy.scale(frames), first)
        actor = self.policy.actor
        mean, _ = actor.action_of(actor.head(actor.body.plain(x)))
        return rotate_by_ray(mean, first, frames.shape[-1])


def export_actor(policy: Policy, path: Path) -> float:
    """
    Write the actor as ONNX (*.onnx) or TorchScript; return its largest error [m/s].

    The error is against the policy, in a batch of another size than it was traced with.
    """
    shape = (policy.config.observation.n_frames, *policy.config.lidar.layout.shape)
    generator = torch.Generator().manual_seed(0)

    def readings(count: int) -> Tensor:
        frames = 40 * torch.rand(count, *shape, generator=generator)
        return torch.where(frames < 20, frames, torch.inf)

    path.parent.mkdir(parents=True, exist_ok=True)
    with torch.no_grad():
        write = _write_onnx if path.suffix == '.onnx' else _write_torchscript
        run = write(PlainActor(policy), readings(2), path)
        frames = readings(7)
        return float((run(frames) - policy.act(frames)).abs().max())


def _write_torchscript(
    actor: PlainActor, frames: Tensor, path: Path
) -> Callable[[Tensor], Tensor]:
    """Write TorchScript; return a function that runs it."""
    torch.jit.trace(actor, frames).save(str(path))
    return torch.jit.load(str(path))


def _write_onnx(actor: PlainActor, frames: Tensor, path: Path) -> Callable[[Tensor], Tensor]:
    """Write ONNX with input `frames` and output `velocities`; return a function that runs it."""
    try:
        import onnx  # noqa: F401
        import onnxruntime
    except ImportError as error:
        raise ConfigError(f"{error}; install it: pip install '.[onnx]'") from None
    torch.onnx.export(
        actor, (frames,), str(path), input_names=['frames'], output_names=['velocities'],
        dynamic_axes={'frames': {0: 'n'}, 'velocities': {0: 'n'}}, dynamo=False,
    )  # fmt: skip
    session = onnxruntime.InferenceSession(str(path), providers=['CPUExecutionProvider'])
    return lambda x: torch.from_numpy(session.run(None, {'frames': x.numpy()})[0])
