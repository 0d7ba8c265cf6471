"""
Metrics: the five of section 5 of the paper with the readings that its wording allows, and others.

A metric of its own needs one entry: METRICS.add(Metric(name, unit, meaning, value, start, count)).
It is then a column of results, a topic, and shown where it says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from shepherd_ros.config import unknown_name
from shepherd_ros.registry import Registry
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.tally import first_tally, MetricsTally, next_tally
import torch
from torch import Tensor

SHOWN_IN = {
    'summary': 'tables of results, and what the demo prints',
    'eval': 'what training measures: its curve, checkpoints and their cards',
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
    instant: bool = False  # known from a state alone, whatever was before
    shown: Mapping[str, int] = field(default_factory=dict)  # SHOWN_IN -> order there

    def __post_init__(self) -> None:
        """Check the places, and fill in titles."""
        for place in self.shown:
            if place not in SHOWN_IN:
                raise unknown_name(f'place of metric {self.name!r}', place, list(SHOWN_IN))
        for title in ('title', 'short'):
            object.__setattr__(self, title, getattr(self, title) or self.words)

    @property
    def words(self) -> str:
        """Return the name in words, with the unit."""
        return self.name.replace('_', ' ') + ('' if self.unit == '1' else f' [{self.unit}]')


METRICS: Registry[Metric] = Registry('metric')  # of herding; another task has its own


def shown(place: str, entries: Mapping[str, Metric] = METRICS) -> list[Metric]:
    """Return the metrics that are shown at one of SHOWN_IN, in their order there."""
    selected = [metric for metric in entries.values() if place in metric.shown]
    return sorted(selected, key=lambda metric: metric.shown[place])


def start_tally(state: WorldState, entries: Registry[Metric] = METRICS) -> MetricsTally:
    """
    Return the tally at the first state, which counts for all but the mean spread.

    entries are the metrics of a task, as below.
    """
    own = {m.name: m.start(state) for m in entries.loaded().values() if m.start is not None}
    return replace(first_tally(state), own=own)


def count_step(
    tally: MetricsTally,
    before: WorldState,
    after: WorldState,
    entries: Registry[Metric] = METRICS,
) -> MetricsTally:
    """Return the tally with one more step, from the true state before it to the one after it."""
    following = next_tally(tally, before, after)
    for name, own in tally.own.items():
        count = entries[name].count
        if count is not None:
            following.own[name] = count(own, before, after)
    return following


def metrics(
    tally: MetricsTally,
    state: WorldState,
    episode_steps: int,
    entries: Registry[Metric] = METRICS,
) -> dict[str, Tensor]:
    """Return the value of each metric for the episode so far, (...) each."""
    return {
        name: metric.value(tally.own.get(name, tally), state, episode_steps)
        for name, metric in entries.loaded().items()
    }


def _completion_time(tally: MetricsTally, state: WorldState, episode_steps: int) -> Tensor:
    return torch.where(tally.completed, tally.completion_time, float(episode_steps))


def _flock_spread(tally: MetricsTally, state: WorldState, episode_steps: int) -> Tensor:
    """Return the mean over steps; spread_done is that of the first state until there is one."""
    mean = tally.spread / tally.steps.clamp(min=1)
    return torch.where(tally.steps > 0, mean, tally.spread_done)


def _flock_spread_per_axis(tally: MetricsTally, state: WorldState, episode_steps: int) -> Tensor:
    mean = tally.spread_per_axis / tally.steps.clamp(min=1)
    return torch.where(tally.steps > 0, mean, tally.spread_per_axis_first)


SHEPHERD_PATH = Metric(
    'shepherd_path_length',
    'm',
    'mean over shepherds of the way of each, whole episode',
    lambda tally, state, steps: tally.shepherd_path,
    title='shepherd path [m]',
    short='shepherd path [m]',
    paper=True,
    shown={'summary': 2, 'eval': 5, 'bag': 2},
)
_BUILT_IN = (
    Metric(
        'completion_time',
        'steps',
        'first step with the center of mass in the goal; T if never',
        _completion_time,
        title='time until the flock is home [steps]',
        short='completion [steps]',
        paper=True,
        shown={'summary': 1, 'eval': 2, 'bag': 1},
    ),
    SHEPHERD_PATH,
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
        shown={'summary': 4, 'eval': 6, 'bag': 4, 'page': 3},
    ),
    Metric(
        'fraction_reached',
        '1',
        'share of sheep that were in the goal at any time',
        lambda tally, state, steps: tally.reached.sum(dim=-1) / state.flock_size,
        title='share that reached the goal',
        short='reached',
        paper=True,
        shown={'summary': 5, 'eval': 3, 'progress': 1, 'bag': 5},
    ),
    Metric(
        'completed',
        '1',
        '1 once the center of mass has been in the goal, else 0',
        lambda tally, state, steps: tally.completed.to(tally.steps.dtype),
        short='episodes in which the flock came home',
        shown={'eval': 1},
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
        instant=True,
        shown={'summary': 6, 'eval': 4, 'progress': 2, 'bag': 6, 'page': 1},
    ),
    Metric(
        'goal_distance',
        'm',
        'center of mass to the center of the goal now',
        lambda tally, state, steps: tally.goal_distance,
        instant=True,
        shown={'page': 2},
    ),
)
for _entry in _BUILT_IN:
    METRICS.add(_entry)
PAPER_METRICS = tuple(metric.name for metric in _BUILT_IN if metric.paper)
