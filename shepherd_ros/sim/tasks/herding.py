"""Herding: bring the flock into the goal (the paper, section 4, with the goal at the origin)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from shepherd_ros.sim.flocking import model_of
from shepherd_ros.sim.goal_motion import first_destination
from shepherd_ros.sim.metrics import METRICS
from shepherd_ros.sim.rng import direction, normal, Stream, uniform
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.tasks.base_task import drawn_radius, Task, TASKS, team_mask
import torch
from torch import Tensor


@TASKS.add
@dataclass(frozen=True)
class Herding(Task):
    """No options: those of the start are in SpawnConfig."""

    name = 'herding'
    meaning = 'herd the flock into the goal'
    progress = '{fraction_in_goal:4.0%} in goal, flock {goal_distance:5.1f} m from its center'
    terms = ('occupancy', 'shaping')
    metrics = METRICS
    achieved = 'fraction_in_goal'

    def start(self, config: Any, seed: Tensor, dtype: torch.dtype) -> WorldState:
        """
        Return the first state of the episodes with these seeds; (...) int64.

        The flock's center lies in a random direction from the goal, the shepherds' center (or,
        with shepherds_around, that of each) in a random direction from the flock's (from its
        first group's, if it has several); each agent is a signed normal distance from its center,
        in a random direction. The k-th agent of a seed starts in the same place whatever the size
        of its group, given the number of groups.
        """
        device, zero = seed.device, torch.zeros_like(seed)
        n, m, start = config.n_sheep, config.n_shepherds, config.spawn

        def places(stream: Stream, nearest: float, farthest: float, count: int) -> Tensor:
            """Return centers, each in a random direction and range, (..., count, 2) m."""
            index = 2 * torch.arange(count, device=device)
            unit_vector = direction(seed, zero, stream, index, torch.float64)
            fraction = uniform(seed, zero, stream, index + 1, torch.float64)
            return unit_vector * (nearest + (farthest - nearest) * fraction)[..., None]

        def around(stream: Stream, count: int) -> Tensor:
            index = torch.arange(count, device=device)
            distance = start.position_std * normal(seed, zero, stream, 2 * index, torch.float64)
            return (
                direction(seed, zero, stream, 2 * index + 1, torch.float64) * distance[..., None]
            )

        limits = (start.flock_distance_min, start.flock_distance_max)
        groups = places(Stream.FLOCK_PLACE, *limits, start.flock_groups)
        # sheep k belongs to group k modulo their number; (..., N, 2) m
        sheep_centers = groups[..., torch.arange(n, device=device) % start.flock_groups, :]
        limits = (start.shepherd_distance_min, start.shepherd_distance_max)
        centers = m if start.shepherds_around else 1
        team = groups[..., :1, :] + places(Stream.SHEPHERD_PLACE, *limits, centers)
        shepherd_mask = team_mask(config, seed)
        shepherds = team + around(Stream.SHEPHERD_POSITION, m)
        goal = torch.zeros((*seed.shape, 2), dtype=dtype, device=device)
        return WorldState(
            seed=seed,
            step=zero,
            sheep=(sheep_centers + around(Stream.SHEEP_POSITION, n)).to(dtype),
            heading=model_of(config.flock).first_heading(seed, n, config.flock).to(dtype),
            sheep_mask=torch.ones((*seed.shape, n), dtype=torch.bool, device=device),
            shepherds=(shepherds * shepherd_mask[..., None]).to(dtype),
            shepherd_mask=shepherd_mask,
            goal=goal,
            destination=first_destination(goal, seed, config),
            goal_radius=drawn_radius(config, seed).to(dtype),
        )
