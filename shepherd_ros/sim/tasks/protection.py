"""
Payload protection: escorts keep a moving crowd out of a region that moves to its destination.

The goal is the payload with its region, the sheep are pedestrians and the shepherds escorts (the
paper, section 3, and its reference 15, arXiv 1910.04537). Neither gives numbers: all are choices.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from shepherd_ros.config import option
from shepherd_ros.sim.flocking import model_of
from shepherd_ros.sim.reward import REWARD_TERMS, RewardTerm, Step
from shepherd_ros.sim.rng import direction, normal, Stream, uniform
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.tasks.base_task import drawn_radius, Task, TASKS, team_mask
from shepherd_ros.sim.tasks.protection_metrics import (
    arrived,
    breached,
    collided,
    PROTECTION_METRICS,
)
from shepherd_ros.sim.vectors import bearing, from_bearing
import torch
from torch import Tensor

_NEAR = 3.0  # [m] from the rim, within which pedestrians cost
_DRAWS = 16  # places that are drawn for a pedestrian, of which it takes the first free one


@TASKS.add
@dataclass(frozen=True)
class Protection(Task):
    """Options of the start of payload protection."""

    name = 'protection'
    meaning = 'keep a moving crowd away from a payload that travels to its destination'
    words = ('pedestrians', 'escort', 'payload')
    progress = 'nearest pedestrian {gap:5.1f} m from the region, {intruders:.0f} were in it'
    flock = 'crowd'
    world = {'n_sheep': 40, 'goal_radius': 2.0, 'goal_speed': 1 / 3}  # noqa: RUF012
    training = {  # noqa: RUF012
        'sheep_min': 20,
        'sheep_max': 60,
        'goal_radius_min': 1.5,
        'goal_radius_max': 3.0,
        'home_share': 0.0,
        'episode_steps': 1000,
    }
    terms = ('breach', 'nearness', 'collision', 'arrival')
    metrics = PROTECTION_METRICS
    achieved = 'clean_success'
    ends = True

    square: float = option(50.0, 'side of the square that pedestrians start in [m]', low=1.0)
    payload_distance: float = option(
        20.0, 'middle of the square to the payload at the start, and to its destination [m]', low=0
    )
    escort_gap: float = option(
        1.0, 'escorts start on a ring so far outside the region, and a half-normal more [m]', low=0
    )
    clearance: float = option(3.0, 'no pedestrian starts so near outside the region [m]', low=0.0)

    def start(self, config: Any, seed: Tensor, dtype: torch.dtype) -> WorldState:
        """
        Return the first state of the episodes with these seeds; (...) int64.

        The payload is in a random direction from the middle, its destination opposite; escorts
        stand evenly around it, the first one ahead; pedestrians are uniform in the square.
        """
        zero, index = torch.zeros_like(seed), torch.arange(config.n_shepherds, device=seed.device)
        course = direction(seed, zero, Stream.GOAL_COURSE, index[:1], torch.float64)[..., 0, :]
        destination = self.payload_distance * course
        radius, mask = drawn_radius(config, seed), team_mask(config, seed)
        angle = bearing(course)[..., None] + 2 * torch.pi * index / mask.sum(-1, keepdim=True)
        spread = normal(seed, zero, Stream.SHEPHERD_POSITION, index, torch.float64).abs()
        ring = (radius[..., None] + self.escort_gap + spread)[..., None] * from_bearing(angle)
        sheep = self._pedestrians(seed, config.n_sheep, -destination, radius)
        model = model_of(config.flock)
        return WorldState(
            seed=seed,
            step=zero,
            sheep=sheep.to(dtype),
            heading=model.first_heading(seed, config.n_sheep, config.flock).to(dtype),
            sheep_mask=torch.ones(sheep.shape[:-1], dtype=torch.bool, device=seed.device),
            shepherds=(ring * mask[..., None] - destination[..., None, :]).to(dtype),
            shepherd_mask=mask,
            goal=-destination.to(dtype),
            goal_radius=radius.to(dtype),
            destination=destination.to(dtype),
        )

    def _pedestrians(self, seed: Tensor, n: int, payload: Tensor, radius: Tensor) -> Tensor:
        """Return places in the square away from the payload (..., 2) m; (..., n, 2) m."""
        index = torch.arange(n * _DRAWS * 2, device=seed.device).reshape(n, _DRAWS, 2)
        zero, half = torch.zeros_like(seed), self.square / 2
        drawn = uniform(seed, zero, Stream.SHEEP_POSITION, index, torch.float64)
        places = (2 * drawn - 1) * half  # (..., n, _DRAWS, 2)
        distance = torch.linalg.vector_norm(places - payload[..., None, None, :], dim=-1)
        free = distance > (radius + self.clearance)[..., None, None]
        first = free.int().argmax(dim=-1)[..., None, None].expand(*places.shape[:-2], 1, 2)
        corner = torch.where(payload > 0, -half, half)[..., None, :]  # where none of them is free
        return torch.where(
            free.any(dim=-1)[..., None], places.gather(-2, first)[..., 0, :], corner
        )

    def terminated(self, state: WorldState) -> Tensor:
        """Return whether the payload has collided or arrived, (...) bool."""
        return collided(state) | arrived(state)


def _breach(step: Step, weight: float) -> Tensor:
    return weight * breached(step.after).to(step.after.sheep.dtype) / step.episode_steps


def _nearness(step: Step, weight: float) -> Tensor:
    near = (1 - step.after.gap / _NEAR).clamp(min=0) * step.after.sheep_mask
    return weight * near.sum(dim=-1) / step.episode_steps


def _stray(step: Step, weight: float) -> Tensor:
    state = step.after
    distance = torch.linalg.vector_norm(state.shepherds - state.goal[..., None, :], dim=-1)
    far = (distance - state.goal_radius[..., None]).clamp(min=0) * state.shepherd_mask
    return weight * far.sum(dim=-1) / state.team_size / step.episode_steps


for _term in (
    RewardTerm('breach', 'protection: pedestrians are in the region', _breach, default=-10.0),
    RewardTerm('nearness', 'protection: pedestrians near its rim', _nearness, default=-0.1),
    RewardTerm(
        'collision',
        'protection: a pedestrian touches the payload',
        lambda step, weight: weight * collided(step.after).to(step.after.sheep.dtype),
        default=-2.0,
    ),
    RewardTerm(
        'arrival',
        'protection: the payload arrives',
        lambda step, weight: weight * arrived(step.after).to(step.after.sheep.dtype),
        default=5.0,
    ),
    RewardTerm('stray', 'protection: meters from its rim to escorts', _stray),
):
    REWARD_TERMS.add(_term)
