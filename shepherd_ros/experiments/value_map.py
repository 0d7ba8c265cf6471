"""Value map: a critic's values of the places of a third shepherd (figure 9)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from shepherd_ros.experiments.bootstrap import Array
from shepherd_ros.experiments.methods import training_of
from shepherd_ros.policy.policy import Policy
from shepherd_ros.sim.frames import Frames
from shepherd_ros.sim.lidar import scan
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor

HALF_SIDE = 25.0  # [m] half the side of the plane, as in the paper
GRID_POINTS = 41  # along each side
MARGIN = 5.0  # [m] of a map around all bodies
N_SHEEP = 10
PATCH = 5  # places along each side of a patch, over which values are averaged
PERCENTILES = (2.0, 98.0)  # ends of the range of values
HIGH_VALUE = 0.8  # threshold of high values, from the low end of the range (0) to the high one (1)
BEHIND_COSINE = 0.5  # cosine of 60 degrees: a place within them is behind the flock
NEAR = 10.0  # [m] of the flock's center: near the flock


@dataclass(frozen=True)
class ValueMap:
    """Values over the plane, with sheep, shepherds and goal."""

    values: Array  # (PLACES, PLACES), rows along y
    sheep: Array  # (N, 2) m
    shepherds: Array  # (2, 2) m
    goal_radius: float

    @property
    def patches(self) -> Array:
        """Return the mean values of patches, (PLACES - PATCH + 1, the same)."""
        return np.asarray(sliding_window_view(self.values, (PATCH, PATCH)).mean(axis=(-2, -1)))

    @property
    def best(self) -> Array:
        """Return the center of the best patch, (2,) m."""
        row, column = np.unravel_index(self.patches.argmax(), self.patches.shape)
        axis = places()
        return np.array([axis[column + PATCH // 2], axis[row + PATCH // 2]])

    @property
    def behind(self) -> float:
        """
        Return the cosine of the angle between the best patch and straight behind the flock.

        Both are seen from the flock; 1 is straight behind it, -1 between flock and goal.
        """
        offset, center = self.best - self.sheep.mean(axis=0), self.sheep.mean(axis=0)
        lengths = np.linalg.norm(offset) * np.linalg.norm(center)
        return float(offset @ center / max(lengths, 1e-9))

    @property
    def gradient(self) -> float:
        """
        Return the mean value behind the flock less that in front of it, over the range of values.

        Places are NEAR the flock and within 60 degrees of straight behind or straight in front.
        """
        center = self.sheep.mean(axis=0)
        offset = np.stack(np.meshgrid(places(), places()), axis=-1) - center
        distance = np.linalg.norm(offset, axis=-1)
        lengths = np.maximum(distance * np.linalg.norm(center), 1e-9)
        cosine, near = offset @ center / lengths, distance <= NEAR
        behind, front = near & (cosine >= BEHIND_COSINE), near & (cosine <= -BEHIND_COSINE)
        low, high = np.percentile(self.values, PERCENTILES)
        difference = self.values[behind].mean() - self.values[front].mean()
        return float(difference / max(high - low, 1e-9))

    @property
    def high_share(self) -> float:
        """Return the fraction of the plane with high values."""
        low, high = np.percentile(self.values, PERCENTILES)
        return float((self.values > low + HIGH_VALUE * (high - low)).mean())


def has_critic(policy: str) -> bool:
    """Return whether a policy's own critic was trained: only PPO does that, from scans."""
    update = training_of(policy).get('ppo')
    return isinstance(update, dict) and update.get('critic_input', 'scans') == 'scans'


def places() -> Array:
    """Return the places of a map along each side, (GRID_POINTS,) m."""
    return np.linspace(-HALF_SIDE, HALF_SIDE, GRID_POINTS)


def value_map(policy: Policy, seed: int = 0) -> ValueMap:
    """
    Return the values of a third shepherd, of a start with that seed and the goal at the origin.

    All frames show the same moment, that of the start.
    """
    world = WorldConfig(n_sheep=N_SHEEP, n_shepherds=3)
    start = spawn(world, torch.tensor([seed]))
    grid = torch.linspace(-HALF_SIDE, HALF_SIDE, GRID_POINTS)
    values = place_values(policy, start, 2, grid, grid)
    return ValueMap(
        values.double().numpy(),
        start.sheep[0].double().numpy(),
        start.shepherds[0, :2].double().numpy(),
        float(start.goal_radius),
    )


def places_around(state: WorldState) -> tuple[Tensor, Tensor]:
    """Return x and y [m] of a square grid around all of a state (1), (GRID_POINTS,) each."""
    bodies = torch.cat([state.sheep[0], state.shepherds[0], state.goal], dim=0)
    low, high = bodies.amin(dim=0), bodies.amax(dim=0)
    half = float((high - low).amax()) / 2 + MARGIN
    center = (low + high) / 2
    steps = torch.linspace(-half, half, GRID_POINTS)
    return center[0] + steps, center[1] + steps


def place_values(
    policy: Policy, state: WorldState, shepherd: int, xs: Tensor, ys: Tensor
) -> Tensor:
    """
    Return the values of a shepherd of a state (1) at places: xs (X,), ys (Y,) m -> (Y, X).

    All frames show the same moment, with the shepherd at each place in turn.
    """
    places = torch.stack(torch.meshgrid(xs, ys, indexing='xy'), dim=-1).reshape(-1, 2)
    parts = [_values(policy, state, shepherd, part) for part in places.split(256)]
    return torch.cat(parts).reshape(len(ys), len(xs))


@torch.no_grad()
def _values(policy: Policy, state: WorldState, shepherd: int, places: Tensor) -> Tensor:
    """Return the values of a shepherd at places (n, 2) m, (n,)."""
    copies = state.world(torch.zeros(len(places), dtype=torch.int64))
    shepherds = copies.shepherds.clone()
    shepherds[:, shepherd] = places
    which = torch.tensor([shepherd])
    ranges = scan(replace(copies, shepherds=shepherds), policy.config.lidar, which)[:, 0]
    frames = Frames(policy.config.observation.n_frames, 1).begin(ranges)
    first = policy.first_ray(frames[:, -1])
    return torch.as_tensor(policy.critic(policy.arrange(policy.scale(frames), first)))
