"""The five metrics of section 5 of the paper, with the readings that its wording allows."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from shepherd_ros.sim.reward import distance_to_rim
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor

# name -> unit and meaning; the first five are the paper's, the others are alternative readings
METRICS = {
    'completion_time': ('steps', 'first step with the center of mass in the goal; T if never'),
    'shepherd_path_length': ('m', 'mean over shepherds of the way of each, whole episode'),
    'flock_path_length': ('m', 'way of the center of mass, whole episode'),
    'flock_spread': ('m', 'root mean square distance to the center of mass, mean over steps'),
    'fraction_reached': ('1', 'share of sheep that were in the goal at any time'),
    'completed': ('1', '1 once the center of mass has been in the goal, else 0'),
    'shepherd_path_to_completion': ('m', 'shepherd_path_length until completion'),
    'flock_path_to_completion': ('m', 'flock_path_length until completion'),
    'flock_spread_per_axis': (
        'm',
        'mean of the standard deviations along x and y, mean over steps',
    ),
    'flock_spread_at_completion': ('m', 'flock spread at completion; of the last step if never'),
    'fraction_in_goal': ('1', 'share of sheep in the goal now'),
    'goal_distance': ('m', 'center of mass to the center of the goal now'),
}
PAPER_METRICS = tuple(METRICS)[:5]


@dataclass(frozen=True)
class MetricsTally:
    """What has been counted of an episode so far, (...) each unless said otherwise."""

    steps: Tensor
    completed: Tensor  # bool
    completion_time: Tensor
    shepherd_path: Tensor
    shepherd_path_done: Tensor
    flock_path: Tensor
    flock_path_done: Tensor
    spread: Tensor  # sum over steps
    spread_per_axis: Tensor  # sum over steps
    spread_done: Tensor
    reached: Tensor  # (..., N) bool
    in_goal: Tensor  # share
    goal_distance: Tensor

    def world(self, index: int | slice | Tensor) -> MetricsTally:
        """Return part of a batch along its first axis."""
        return replace(self, **{f.name: getattr(self, f.name)[index] for f in fields(self)})


def flock_spread(state: WorldState) -> tuple[Tensor, Tensor]:
    """Return the rms distance to the center and the mean deviation per axis, (...) m."""
    offset = (state.sheep - state.center[..., None, :]) * state.sheep_mask[..., None]
    variance = offset.square().sum(dim=-2) / state.flock_size[..., None]  # (..., 2)
    return variance.sum(dim=-1).sqrt(), variance.sqrt().mean(dim=-1)


def _inside(state: WorldState) -> tuple[Tensor, Tensor, Tensor]:
    """Return who is in the goal (..., N), the center's distance (...) m, and if that is inside."""
    inside = (distance_to_rim(state) <= 0) & state.sheep_mask
    distance = torch.linalg.vector_norm(state.center - state.goal, dim=-1)
    return inside, distance, distance <= state.goal_radius


def start_tally(state: WorldState) -> MetricsTally:
    """Return the tally at the first state, which counts for all but the mean spread."""
    inside, distance, completed = _inside(state)
    zero = torch.zeros_like(distance)
    return MetricsTally(
        steps=zero,
        completed=completed,
        completion_time=zero,
        shepherd_path=zero,
        shepherd_path_done=zero,
        flock_path=zero,
        flock_path_done=zero,
        spread=zero,
        spread_per_axis=zero,
        spread_done=flock_spread(state)[0],
        reached=inside,
        in_goal=inside.sum(dim=-1) / state.flock_size,
        goal_distance=distance,
    )


def count_step(tally: MetricsTally, before: WorldState, after: WorldState) -> MetricsTally:
    """Return the tally with one more step, from the true state before it to the one after it."""
    inside, distance, in_goal = _inside(after)
    spread, per_axis = flock_spread(after)
    way = torch.linalg.vector_norm(after.shepherds - before.shepherds, dim=-1)
    way = (way * after.shepherd_mask).sum(dim=-1) / after.team_size
    shepherd_path = tally.shepherd_path + way
    flock_path = tally.flock_path + torch.linalg.vector_norm(after.center - before.center, dim=-1)
    steps = tally.steps + 1
    done = tally.completed
    return MetricsTally(
        steps=steps,
        completed=done | in_goal,
        completion_time=torch.where(done, tally.completion_time, steps),
        shepherd_path=shepherd_path,
        shepherd_path_done=torch.where(done, tally.shepherd_path_done, shepherd_path),
        flock_path=flock_path,
        flock_path_done=torch.where(done, tally.flock_path_done, flock_path),
        spread=tally.spread + spread,
        spread_per_axis=tally.spread_per_axis + per_axis,
        spread_done=torch.where(done, tally.spread_done, spread),
        reached=tally.reached | inside,
        in_goal=inside.sum(dim=-1) / after.flock_size,
        goal_distance=distance,
    )


def metrics(tally: MetricsTally, state: WorldState, episode_steps: int) -> dict[str, Tensor]:
    """Return METRICS of the episode so far, (...) each."""
    counted = tally.steps.clamp(min=1)
    now, now_per_axis = flock_spread(state)
    started = tally.steps > 0
    return {
        'completion_time': torch.where(
            tally.completed, tally.completion_time, float(episode_steps)
        ),
        'shepherd_path_length': tally.shepherd_path,
        'flock_path_length': tally.flock_path,
        'flock_spread': torch.where(started, tally.spread / counted, now),
        'fraction_reached': tally.reached.sum(dim=-1) / state.flock_size,
        'completed': tally.completed.to(tally.steps.dtype),
        'shepherd_path_to_completion': tally.shepherd_path_done,
        'flock_path_to_completion': tally.flock_path_done,
        'flock_spread_per_axis': torch.where(
            started, tally.spread_per_axis / counted, now_per_axis
        ),
        'flock_spread_at_completion': tally.spread_done,
        'fraction_in_goal': tally.in_goal,
        'goal_distance': tally.goal_distance,
    }
