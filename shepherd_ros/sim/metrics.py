"""
Metrics: the five of section 5 of the paper with the readings that its wording allows, and others.

A metric of its own needs one entry: METRICS.add(Metric(name, unit, meaning, value, start, count)).
It is then a column of results, a topic, and shown where it says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from shepherd_ros.config import unknown_name
from shepherd_ros.registry import Registry
from shepherd_ros.sim.reward import distance_to_rim
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor

PLACES = {
    'summary': 'tables of results, and what the demo prints',
    'judge': 'what training measures: its curve, checkpoints and their cards',
    'progress': 'lines that a training prints',
    'bag': 'table of bag info',
    'page': 'curves of a replay',
}


@dataclass(frozen=True)
class Metric:
    """
    A number for each episode, known at any step.

    value(counted, state, episode_steps) returns it, (...), from what was counted until a state:
    what start(first state) and, step by step, count(counted, state before, state after) return,
    (...) or (..., N); without start, the MetricsTally that all share.
    """

    name: str
    unit: str  # 1: a share, from 0 to 1
    meaning: str
    value: Callable[[Any, WorldState, int], Tensor]
    start: Callable[[WorldState], Tensor] | None = None
    count: Callable[[Tensor, WorldState, WorldState], Tensor] | None = None
    title: str = ''  # on an axis; its name by default
    short: str = ''  # above a column; its name by default
    paper: bool = False
    shown: Mapping[str, int] = field(default_factory=dict)  # PLACES -> order there

    def __post_init__(self) -> None:
        """Check the places, and fill in titles."""
        for place in self.shown:
            if place not in PLACES:
                raise unknown_name(f'place of metric {self.name!r}', place, list(PLACES))
        for title in ('title', 'short'):
            object.__setattr__(self, title, getattr(self, title) or self.words)

    @property
    def words(self) -> str:
        """Return the name in words, with the unit."""
        return self.name.replace('_', ' ') + ('' if self.unit == '1' else f' [{self.unit}]')


METRICS: Registry[Metric] = Registry('metric')


def shown(place: str) -> list[Metric]:
    """Return the metrics that are shown at one of PLACES, in their order there."""
    found = [metric for metric in METRICS.values() if place in metric.shown]
    return sorted(found, key=lambda metric: metric.shown[place])


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
        """Return part of a batch along its first axis."""
        return self._each(lambda mine, _: mine[index], self)

    def where(self, chosen: Tensor, other: MetricsTally) -> MetricsTally:
        """Return this tally for the chosen worlds (B,) bool, another one for the rest."""

        def pick(mine: Tensor, theirs: Tensor) -> Tensor:
            return torch.where(chosen.reshape(-1, *(1,) * (mine.dim() - 1)), mine, theirs)

        return self._each(pick, other)


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
        own={m.name: m.start(state) for m in METRICS.values() if m.start is not None},
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
        own={name: _counted(name, own, before, after) for name, own in tally.own.items()},
    )


def _counted(name: str, own: Tensor, before: WorldState, after: WorldState) -> Tensor:
    """Return what a metric has counted, with one more step."""
    count = METRICS[name].count
    return own if count is None else count(own, before, after)


def metrics(tally: MetricsTally, state: WorldState, episode_steps: int) -> dict[str, Tensor]:
    """Return METRICS of the episode so far, (...) each."""
    return {
        name: metric.value(tally.own.get(name, tally), state, episode_steps)
        for name, metric in METRICS.items()
    }


def _completion_time(tally: MetricsTally, state: WorldState, episode_steps: int) -> Tensor:
    return torch.where(tally.completed, tally.completion_time, float(episode_steps))


def _flock_spread(tally: MetricsTally, state: WorldState, episode_steps: int) -> Tensor:
    """Return the mean over steps; spread_done is that of the first state until there is one."""
    mean = tally.spread / tally.steps.clamp(min=1)
    return torch.where(tally.steps > 0, mean, tally.spread_done)


def _flock_spread_per_axis(tally: MetricsTally, state: WorldState, episode_steps: int) -> Tensor:
    mean = tally.spread_per_axis / tally.steps.clamp(min=1)
    return torch.where(tally.steps > 0, mean, flock_spread(state)[1])


_BUILT_IN = (
    Metric(
        'completion_time',
        'steps',
        'first step with the center of mass in the goal; T if never',
        _completion_time,
        title='time until the flock is home [steps]',
        short='completion [steps]',
        paper=True,
        shown={'summary': 1, 'judge': 2, 'bag': 1},
    ),
    Metric(
        'shepherd_path_length',
        'm',
        'mean over shepherds of the way of each, whole episode',
        lambda tally, state, steps: tally.shepherd_path,
        title='shepherd path [m]',
        short='shepherd path [m]',
        paper=True,
        shown={'summary': 2, 'judge': 5, 'bag': 2},
    ),
    Metric(
        'flock_path_length',
        'm',
        'way of the center of mass, whole episode',
        lambda tally, state, steps: tally.flock_path,
        title='flock path [m]',
        short='flock path [m]',
        paper=True,
        shown={'summary': 3, 'bag': 3},
    ),
    Metric(
        'flock_spread',
        'm',
        'root mean square distance to the center of mass, mean over steps',
        _flock_spread,
        short='spread [m]',
        paper=True,
        shown={'summary': 4, 'judge': 6, 'bag': 4, 'page': 3},
    ),
    Metric(
        'fraction_reached',
        '1',
        'share of sheep that were in the goal at any time',
        lambda tally, state, steps: tally.reached.sum(dim=-1) / state.flock_size,
        title='share that reached the goal',
        short='reached',
        paper=True,
        shown={'summary': 5, 'judge': 3, 'progress': 1, 'bag': 5},
    ),
    Metric(
        'completed',
        '1',
        '1 once the center of mass has been in the goal, else 0',
        lambda tally, state, steps: tally.completed.to(tally.steps.dtype),
        short='episodes in which the flock came home',
        shown={'judge': 1},
    ),
    Metric(
        'shepherd_path_to_completion',
        'm',
        'shepherd_path_length until completion',
        lambda tally, state, steps: tally.shepherd_path_done,
        shown={'summary': 7},
    ),
    Metric(
        'flock_path_to_completion',
        'm',
        'flock_path_length until completion',
        lambda tally, state, steps: tally.flock_path_done,
    ),
    Metric(
        'flock_spread_per_axis',
        'm',
        'mean of the standard deviations along x and y, mean over steps',
        _flock_spread_per_axis,
    ),
    Metric(
        'flock_spread_at_completion',
        'm',
        'flock spread at completion; of the last step if never',
        lambda tally, state, steps: tally.spread_done,
    ),
    Metric(
        'fraction_in_goal',
        '1',
        'share of sheep in the goal now',
        lambda tally, state, steps: tally.in_goal,
        title='share in the goal at the end',
        short='in goal at the end',
        shown={'summary': 6, 'judge': 4, 'progress': 2, 'bag': 6, 'page': 1},
    ),
    Metric(
        'goal_distance',
        'm',
        'center of mass to the center of the goal now',
        lambda tally, state, steps: tally.goal_distance,
        shown={'page': 2},
    ),
)
for _entry in _BUILT_IN:
    METRICS.add(_entry)
PAPER_METRICS = tuple(metric.name for metric in _BUILT_IN if metric.paper)
