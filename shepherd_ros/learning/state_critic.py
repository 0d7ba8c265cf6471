"""
A critic on the true state, for PPO only: the policy acts on scans, what teaches it need not.

It reads features of the world from the place of each shepherd. They do not change when the world
is turned or mirrored about the goal, or when others change places: lengths are along and across
the line from the goal to the middle of the flock, and across is positive where the shepherd is.
"""

from __future__ import annotations

from shepherd_ros.sim.rollout import Moment
from shepherd_ros.sim.vectors import masked_mean, unit
import torch
from torch import nn, Tensor

HIDDEN = 128  # units of each of two layers
LENGTH = 10.0  # [m] unit of lengths
FEATURES = (
    'distance of the flock from the goal', 'radius of the goal', 'share of the flock inside',
    'mean distance of sheep outside from the rim', 'greatest distance of a sheep from the rim',
    'spread of the flock', 'spread along the line', 'spread across the line',
    'logarithm of the number of sheep', 'number of shepherds', 'noise of perception',
    'own place along the line', 'own place across', 'own distance from the goal',
    'own distance from the middle of the flock', 'distance of the nearest sheep',
    'distance of the nearest shepherd', 'middle of the others along the line',
    'middle of the others across', 'spread of the others along', 'spread of the others across',
)  # fmt: skip


def state_features(moment: Moment) -> Tensor:
    """Return FEATURES of a moment for each shepherd, (B, H, F) of order one."""
    state = moment.state
    line = state.center - state.goal  # (B, 2)
    distance = torch.linalg.vector_norm(line, dim=-1)
    along = unit(line)
    across = torch.stack([-along[..., 1], along[..., 0]], dim=-1)
    axes = torch.stack([along, across], dim=-1)  # (B, 2, 2)
    sheep = (state.sheep - state.center[..., None, :]) @ axes
    variance = masked_mean(sheep.square(), state.sheep_mask)  # (B, 2)
    gap = state.gap.clamp(min=0.0) * state.sheep_mask
    outside = (gap > 0).sum(dim=-1).clamp(min=1)
    size = state.flock_size
    flock = torch.stack(
        [
            distance / LENGTH, state.goal_radius / LENGTH, state.inside.sum(dim=-1) / size,
            gap.sum(dim=-1) / outside / LENGTH, gap.amax(dim=-1) / LENGTH,
            variance.sum(dim=-1).sqrt() / LENGTH, *(variance.sqrt() / LENGTH).unbind(dim=-1),
            size.log() / 5, state.team_size / 6,
            torch.full_like(distance, moment.config.noise_std),
        ],
        dim=-1,
    )  # fmt: skip
    own = _own_features(moment, axes)
    return torch.cat([flock[:, None].expand(-1, own.shape[1], -1), own], dim=-1)


def _own_features(moment: Moment, axes: Tensor) -> Tensor:
    """Return the features that differ between shepherds, (B, H, 10)."""
    state = moment.state
    place = (state.shepherds - state.goal[..., None, :]) @ axes  # (B, H, 2)
    side = torch.where(place[..., 1:] >= 0, 1.0, -1.0)
    mirror = torch.cat([torch.ones_like(side), side], dim=-1)
    offset = place[..., :, None, :] - place[..., None, :, :]  # (B, H, H, 2)
    apart = torch.linalg.vector_norm(offset, dim=-1)
    self_or_absent = torch.eye(place.shape[1], dtype=torch.bool, device=place.device)
    others = state.shepherd_mask[:, None, :] & ~self_or_absent  # (B, H, H)
    nearest = torch.where(others, apart, 3 * LENGTH).amin(dim=-1).clamp(max=3 * LENGTH)
    near_sheep = torch.cdist(state.shepherds, state.sheep)
    near_sheep = torch.where(state.sheep_mask[:, None], near_sheep, torch.inf).amin(dim=-1)
    count = others.sum(dim=-1, keepdim=True).clamp(min=1)
    team = place[:, None].expand(-1, place.shape[1], -1, -1)
    mean = (team * others[..., None]).sum(dim=-2) / count
    spread = ((team - mean[..., None, :]).square() * others[..., None]).sum(dim=-2) / count
    center = state.center[..., None, :]
    return torch.cat(
        [
            place * mirror / LENGTH,
            torch.linalg.vector_norm(place, dim=-1, keepdim=True) / LENGTH,
            torch.linalg.vector_norm(state.shepherds - center, dim=-1, keepdim=True) / LENGTH,
            near_sheep[..., None] / LENGTH, nearest[..., None] / LENGTH,
            mean * mirror / LENGTH, spread.sqrt() / LENGTH,
        ],
        dim=-1,
    )  # fmt: skip


class StateCritic(nn.Module):
    """From state_features (n, F) to the expected return of the team, (n,)."""

    def __init__(self) -> None:
        """Create the layers."""
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(len(FEATURES), HIDDEN), nn.Tanh(), nn.Linear(HIDDEN, HIDDEN), nn.Tanh(),
            nn.Linear(HIDDEN, 1),
        )  # fmt: skip

    def forward(self, features: Tensor) -> Tensor:
        """Return the value (n,)."""
        return self.layers(features)[:, 0]
