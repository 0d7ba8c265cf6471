"""
Strömbom flock: sheep graze until a shepherd is near, then flee, keep together and keep apart.

D. Strömbom et al. 2014, "Solving the shepherding problem", J. R. Soc. Interface 11:20140719,
equations 4.1 to 4.3; for several shepherds their unit pushes are added, as in El-Fiqi et al. 2020.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from shepherd_ros.config import option
from shepherd_ros.sim.compiled import compilable
from shepherd_ros.sim.flocking.flock_model import FLOCK_MODELS, FlockConfig, FlockModel
from shepherd_ros.sim.flocking.strombom_flock_compiled import strombom_step
from shepherd_ros.sim.fused import fused
from shepherd_ros.sim.rng import direction, Stream, uniform
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import EPSILON, unit
import torch
from torch import Tensor


@dataclass(frozen=True)
class StrombomFlock(FlockConfig):
    """Parameters of the Strömbom flock: Table 1 of the paper, unless said otherwise."""

    repulsion_option: ClassVar[str] = 'sheep_repulsion'

    n_neighbors: int = option(90, 'n [-]: nearest sheep that attract, at most all others', low=1)
    shepherd_range: float = option(65 / 3, 'r_s [m]: a sheep notices shepherds so near', low=0.0)
    sheep_range: float = option(
        1.0, 'r_a [m]: sheep so near repel each other; Table 1 has 10, which explodes', low=0.0
    )
    sheep_repulsion: float = option(2.0, 'rho_a [-]: weight of repulsion by sheep', low=0.0)
    cohesion: float = option(1.05, 'c [-]: weight of attraction to the nearest sheep', low=0.0)
    shepherd_repulsion: float = option(1.0, 'rho_s [-]: weight of repulsion by shepherds', low=0.0)
    inertia: float = option(0.5, 'h [-]: weight of the last heading', low=0.0)
    noise: float = option(0.3, 'e [-]: weight of a random direction, each step', low=0.0)
    graze_probability: float = option(
        0.05, 'p [-]: chance to move while no shepherd is near, each step', low=0.0, high=1.0
    )
    normalize_shepherds: bool = option(
        False, 'make the sum of the pushes of all shepherds a unit vector (choice: plain sum)'
    )
    metric_attraction: bool = option(
        False, 'attraction grows with the distance to the local center [m] (choice: unit vector)'
    )

    @property
    def notice_range(self) -> float:
        """Return r_s [m]."""
        return self.shepherd_range

    @property
    def repulsion_range(self) -> float:
        """Return r_a [m]."""
        return self.sheep_range


def offsets(points: Tensor, others: Tensor) -> tuple[Tensor, Tensor]:
    """Return x and y of point minus other; (..., N, 2), (..., K, 2) m -> two (..., N, K) m."""
    x = points[..., :, None, 0] - others[..., None, :, 0]
    y = points[..., :, None, 1] - others[..., None, :, 1]
    return x, y


def push(x: Tensor, y: Tensor, squared: Tensor, near: Tensor) -> Tensor:
    """Return the sum of unit offsets over near pairs; (..., N, K) each -> (..., N, 2)."""
    inverse = torch.where(near & (squared > EPSILON**2), squared.clamp(min=EPSILON**2).rsqrt(), 0)
    return torch.stack([(x * inverse).sum(dim=-1), (y * inverse).sum(dim=-1)], dim=-1)


def local_center(sheep: Tensor, mask: Tensor, squared: Tensor, n_neighbors: int) -> Tensor:
    """
    Return the mean position of the nearest others of each sheep, itself where there are none.

    sheep (..., N, 2) m, mask (..., N), squared distances (..., N, N) m2 -> (..., N, 2) m.
    Whichever set is smaller is searched: the nearest, or the farthest, which are taken off the
    whole.
    """
    n = sheep.shape[-2]
    others = mask.sum(dim=-1)[..., None, None] - 1  # (..., 1, 1)
    count = others.clamp(max=n_neighbors)
    far = max(n - 1 - n_neighbors, 0)
    self_or_absent = torch.eye(n, dtype=torch.bool, device=sheep.device) | ~mask[..., None, :]

    def sum_at(index: Tensor, chosen: Tensor) -> Tensor:
        whole = sheep.transpose(-1, -2)[..., :, None, :].expand(*index.shape[:-2], 2, n, n)
        picked = whole.gather(-1, index[..., None, :, :].expand(*whole.shape[:-1], -1))
        return (picked * chosen[..., None, :, :]).sum(dim=-1).transpose(-1, -2)

    if far <= n_neighbors:
        total = (sheep * mask[..., None]).sum(dim=-2, keepdim=True) - sheep
        if far > 0:
            index = squared.masked_fill(self_or_absent, -1.0).topk(far, dim=-1).indices
            rank = torch.arange(far, device=sheep.device)
            total = total - sum_at(index, rank < others - n_neighbors)
    else:
        nearest = squared.masked_fill(self_or_absent, torch.inf).topk(n_neighbors, largest=False)
        total = sum_at(nearest.indices, nearest.values.isfinite())
    return torch.where(count > 0, total / count.clamp(min=1), sheep)


@fused
def forces(
    sheep: Tensor, mask: Tensor, shepherds: Tensor, shepherd_mask: Tensor, config: StrombomFlock
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """
    Return the forces on each sheep before their weights.

    The sum of unit pushes by near sheep (..., N, 2), the offset to the local center (..., N, 2) m,
    the sum of unit pushes by shepherds (..., N, 2), and whether any is noticed (..., N) bool.
    """
    x, y = offsets(sheep, sheep)
    squared = x * x + y * y
    from_sheep = push(x, y, squared, (squared < config.sheep_range**2) & mask[..., None, :])
    # relative to one sheep: means of far places would be rounded by more than close sheep differ
    near = sheep - sheep[..., :1, :]
    attraction = local_center(near, mask, squared, config.n_neighbors) - near
    x, y = offsets(sheep, shepherds)
    squared = x * x + y * y
    noticed = (squared < config.shepherd_range**2) & shepherd_mask[..., None, :]
    return from_sheep, attraction, push(x, y, squared, noticed), noticed.any(dim=-1)


def strombom_flock_step(
    state: WorldState, config: StrombomFlock, dt: float
) -> tuple[Tensor, Tensor]:
    """
    Return sheep [m] and heading after dt, (..., N, 2) each; a reacting sheep moves speed * dt.

    Equations 4.1 to 4.3: each term is a unit vector before it is weighted, and so is the sum.
    Only the pushes of several shepherds are added as they are.
    """
    if compilable(state.sheep, state.shepherds):
        return strombom_step(state, config, dt)
    sheep = state.sheep
    index = torch.arange(sheep.shape[-2], device=sheep.device)
    from_sheep, attraction, from_shepherds, reacting = forces(
        sheep, state.sheep_mask, state.shepherds, state.shepherd_mask, config
    )
    if not config.metric_attraction:
        attraction = unit(attraction)
    if config.normalize_shepherds:
        from_shepherds = unit(from_shepherds)
    random = direction(state.seed, state.step, Stream.TURN, index, sheep.dtype)
    fleeing = unit(
        config.inertia * state.heading
        + config.cohesion * attraction
        + config.sheep_repulsion * unit(from_sheep)
        + config.shepherd_repulsion * from_shepherds
        + config.noise * random
    )
    # forces that cancel exactly leave no direction: the sheep then keeps its heading
    stuck = (fleeing == 0).all(dim=-1, keepdim=True)
    fleeing = torch.where(stuck, state.heading, fleeing)
    reacting = reacting[..., None]
    chance = uniform(state.seed, state.step, Stream.GRAZE, index, sheep.dtype)[..., None]
    moving = reacting | (chance < config.graze_probability)
    heading = torch.where(reacting, fleeing, torch.where(moving, random, state.heading))
    return sheep + torch.where(moving, (config.speed * dt) * heading, 0.0), heading


def _first_heading(seed: Tensor, n: int, config: StrombomFlock) -> Tensor:
    """Return independent random headings; (...) int64 -> (..., n, 2)."""
    index = torch.arange(n, device=seed.device)
    return direction(seed, torch.zeros_like(seed), Stream.HEADING, index)


FLOCK_MODELS.add(FlockModel('strombom', StrombomFlock, _first_heading, strombom_flock_step))
