"""A plug-in: a metric without and one with a count of its own."""

from shepherd_ros.sim.metrics import Metric, METRICS, MetricsTally
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor

NEAR = 10.0  # [m]


def share_near(state: WorldState) -> Tensor:
    """Return the share of sheep that are near a shepherd, (...)."""
    offset = state.sheep[..., :, None, :] - state.shepherds[..., None, :, :]
    near = (offset.square().sum(dim=-1) < NEAR**2) & state.shepherd_mask[..., None, :]
    return (near.any(dim=-1) & state.sheep_mask).sum(dim=-1) / state.flock_size


def now(tally: MetricsTally, state: WorldState, episode_steps: int) -> Tensor:
    """Return the share in a state."""
    return share_near(state)


def most(counted: Tensor, state: WorldState, episode_steps: int) -> Tensor:
    """Return the largest share so far."""
    return counted


METRICS.add(
    Metric(
        'fraction_near',
        '1',
        'share of sheep within 10 m of a shepherd now',
        now,
        shown={'summary': 8, 'eval': 7, 'bag': 7},
    )
)
METRICS.add(
    Metric(
        'most_near',
        '1',
        'largest fraction_near so far',
        most,
        start=share_near,
        count=lambda own, before, after: torch.maximum(own, share_near(after)),
    )
)
