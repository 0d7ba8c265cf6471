"""Metrics of payload protection."""

from __future__ import annotations

from dataclasses import replace

from shepherd_ros.registry import Registry
from shepherd_ros.sim.metrics import Metric, SHEPHERD_PATH
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor

COLLISION_DISTANCE = 0.75  # [m] between the middles of payload (0.5 m) and pedestrian (0.25 m)
PROTECTION_METRICS: Registry[Metric] = Registry('metric of protection')


def collided(state: WorldState) -> Tensor:
    """Return whether a pedestrian touches the payload, (...) bool."""
    near = state.gap + state.goal_radius[..., None] <= COLLISION_DISTANCE
    return (near & state.sheep_mask).any(dim=-1)


def arrived(state: WorldState) -> Tensor:
    """Return whether the payload is at its destination, (...) bool."""
    return (state.goal == state.destination).all(dim=-1)


def breached(state: WorldState) -> Tensor:
    """Return whether a pedestrian is in the region, (...) bool."""
    return state.inside.any(dim=-1)


def _success(state: WorldState) -> Tensor:
    return (arrived(state) & ~collided(state)).to(state.sheep.dtype)


def _first_breach(state: WorldState) -> Tensor:
    return breached(state).to(state.sheep.dtype)


def _share(counted: Tensor, state: WorldState, episode_steps: int) -> Tensor:
    """Return a sum over the steps after the first state, by step."""
    return counted / state.step.clamp(min=1)


def _nearest(state: WorldState) -> Tensor:
    return torch.where(state.sheep_mask, state.gap, torch.inf).amin(dim=-1)


def _no_paths(state: WorldState) -> Tensor:
    return torch.zeros_like(state.goal)


def _paths(own: Tensor, before: WorldState, after: WorldState) -> Tensor:
    """Return the ways of escorts, their mean, and of the payload; (..., 2) m."""
    escort = torch.linalg.vector_norm(after.shepherds - before.shepherds, dim=-1)
    escort = (escort * after.shepherd_mask).sum(dim=-1) / after.team_size
    payload = torch.linalg.vector_norm(after.goal - before.goal, dim=-1)
    return own + torch.stack([escort, payload], dim=-1)


def _payload_distance(own: Tensor, before: WorldState, after: WorldState) -> Tensor:
    distance = torch.linalg.vector_norm(after.shepherds - after.goal[..., None, :], dim=-1)
    return own + (distance * after.shepherd_mask).sum(dim=-1) / after.team_size


for _metric in (
    Metric(
        'success',
        '1',
        '1 once the payload has arrived without a collision, else 0',
        lambda tally, state, steps: _success(state),
        instant=True,
        shown={'summary': 1, 'eval': 1, 'bag': 1},
    ),
    Metric(
        'clean_success',
        '1',
        'success without any pedestrian in the region on the way',
        lambda counted, state, steps: _success(state) * (1 - counted),
        start=_first_breach,
        count=lambda own, before, after: torch.maximum(own, _first_breach(after)),
        shown={'summary': 2, 'eval': 2, 'progress': 1, 'bag': 2},
    ),
    Metric(
        'breach_share',
        '1',
        'share of steps with a pedestrian in the region',
        _share,
        start=lambda state: torch.zeros_like(state.goal_radius),
        count=lambda own, before, after: own + _first_breach(after),
        shown={'summary': 3, 'eval': 3, 'progress': 2, 'bag': 3},
    ),
    Metric(
        'intruders',
        'pedestrians',
        'pedestrians that were in the region at any time',
        lambda counted, state, steps: counted.sum(dim=-1).to(state.sheep.dtype),
        start=lambda state: state.inside,
        count=lambda own, before, after: own | after.inside,
        shown={'summary': 4, 'eval': 4, 'bag': 4},
    ),
    Metric(
        'smallest_gap',
        'm',
        'smallest distance of a pedestrian to the rim of the region, negative inside',
        lambda counted, state, steps: counted,
        start=_nearest,
        count=lambda own, before, after: torch.minimum(own, _nearest(after)),
        shown={'summary': 5, 'bag': 5},
    ),
    Metric(
        'steps_survived',
        'steps',
        'steps until the end of the episode',
        lambda tally, state, steps: state.step.to(state.sheep.dtype),
        instant=True,
        shown={'summary': 6, 'eval': 5, 'bag': 6},
    ),
    replace(SHEPHERD_PATH, paper=False, shown={'summary': 7, 'eval': 6}),
    Metric(
        'path_per_payload_meter',
        '1',
        'way of an escort by that of the payload',
        lambda counted, state, steps: counted[..., 0] / counted[..., 1].clamp(min=1e-6),
        start=_no_paths,
        count=_paths,
    ),
    Metric(
        'payload_distance',
        'm',
        'distance of escorts to the middle of the payload, mean over steps',
        _share,
        start=lambda state: torch.zeros_like(state.goal_radius),
        count=_payload_distance,
    ),
    Metric(
        'gap',
        'm',
        'distance of the nearest pedestrian to the rim of the region now',
        lambda tally, state, steps: _nearest(state),
        instant=True,
        shown={'page': 1},
    ),
):
    PROTECTION_METRICS.add(_metric)
