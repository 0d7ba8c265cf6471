"""Counts and sums over the steps of an episode, for its metrics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace

from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor


@dataclass(frozen=True)
class MetricsTally:
    """Counts and sums of an episode so far, (...) each unless said otherwise."""

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
    spread_per_axis_first: Tensor  # of the first state
    reached: Tensor  # (..., N) bool
    in_goal: Tensor  # share
    goal_distance: Tensor
    own: dict[str, Tensor] = field(default_factory=dict)  # of metrics that count for themselves

    def _each(
        self, change: Callable[[Tensor, Tensor], Tensor], other: MetricsTally
    ) -> MetricsTally:
        """Return the tally with change(own, other's) of each tensor."""
        parts = {
            f.name: change(getattr(self, f.name), getattr(other, f.name))
            for f in fields(self)
            if f.name != 'own'
        }
        own = {name: change(value, other.own[name]) for name, value in self.own.items()}
        return replace(self, **parts, own=own)

    def world(self, index: int | slice | Tensor) -> MetricsTally:
        """Return part of a batch, selected along its first axis."""
        return self._each(lambda value, _: value[index], self)

    def where(self, chosen: Tensor, other: MetricsTally) -> MetricsTally:
        """Return this tally for the chosen worlds (B,) bool, another one for the rest."""

        def pick(own_value: Tensor, other_value: Tensor) -> Tensor:
            return torch.where(
                chosen.reshape(-1, *(1,) * (own_value.dim() - 1)), own_value, other_value
            )

        return self._each(pick, other)


def flock_spread(state: WorldState) -> tuple[Tensor, Tensor]:
    """Return the rms distance to the center and the mean deviation per axis, (...) m."""
    offset = (state.sheep - state.center[..., None, :]) * state.sheep_mask[..., None]
    variance = offset.square().sum(dim=-2) / state.flock_size[..., None]  # (..., 2)
    return variance.sum(dim=-1).sqrt(), variance.sqrt().mean(dim=-1)


def _home(state: WorldState) -> tuple[Tensor, Tensor]:
    """Return the distance of the center to the goal's, (...) m, and whether it is inside."""
    distance = torch.linalg.vector_norm(state.center - state.goal, dim=-1)
    return distance, distance <= state.goal_radius


def first_tally(state: WorldState) -> MetricsTally:
    """Return the tally at the first state, which counts for all but the mean spread."""
    distance, completed = _home(state)
    zero = torch.zeros_like(distance)
    spread, per_axis = flock_spread(state)
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
        spread_done=spread,
        spread_per_axis_first=per_axis,
        reached=state.inside,
        in_goal=state.inside.sum(dim=-1) / state.flock_size,
        goal_distance=distance,
    )


def next_tally(tally: MetricsTally, before: WorldState, after: WorldState) -> MetricsTally:
    """Return the tally with one more step, from the true state before it to the one after it."""
    distance, in_goal = _home(after)
    spread, per_axis = flock_spread(after)
    displacement = torch.linalg.vector_norm(after.shepherds - before.shepherds, dim=-1)
    displacement = (displacement * after.shepherd_mask).sum(dim=-1) / after.team_size
    shepherd_path = tally.shepherd_path + displacement
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
        spread_per_axis_first=tally.spread_per_axis_first,
        reached=tally.reached | after.inside,
        in_goal=after.inside.sum(dim=-1) / after.flock_size,
        goal_distance=distance,
        own=dict(tally.own),
    )
