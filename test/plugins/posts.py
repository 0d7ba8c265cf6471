"""A plug-in: a channel of a lidar that sees three posts."""

from shepherd_ros.sim.lidar_layout import Channel, CHANNELS
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor

PLACES = ((20.0, 0.0), (-10.0, 10.0), (0.0, -15.0))  # m
RADIUS = 2.0  # [m]


def posts(state: WorldState) -> tuple[Tensor, Tensor, Tensor]:
    """Return where the posts are, how wide, and that they are there."""
    batch, kind = state.step.shape, state.sheep
    centers = torch.tensor(PLACES, dtype=kind.dtype, device=kind.device)
    radius = torch.full((*batch, len(PLACES)), RADIUS, dtype=kind.dtype, device=kind.device)
    return centers.expand(*batch, -1, -1), radius, torch.ones_like(radius, dtype=torch.bool)


CHANNELS.add(Channel('posts', 'ranges to posts', discs=posts, hides=True))
