"""A plug-in: a task, to bring the first sheep into the goal."""

from __future__ import annotations

from dataclasses import dataclass

from shepherd_ros.config import option
from shepherd_ros.registry import Registry
from shepherd_ros.sim.metrics import Metric
from shepherd_ros.sim.reward import REWARD_TERMS, RewardTerm
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.tasks import TASKS
from shepherd_ros.sim.tasks.herding import Herding
from torch import Tensor

METRICS_OF_FETCH: Registry[Metric] = Registry('metric of fetch')
METRICS_OF_FETCH.add(
    Metric(
        'fetched',
        '1',
        '1 once a sheep is in the goal, else 0',
        lambda tally, state, steps: state.inside.any(dim=-1).to(state.sheep.dtype),
        instant=True,
        shown={'summary': 1, 'eval': 1, 'progress': 1, 'bag': 1, 'page': 1},
    )
)
REWARD_TERMS.add(
    RewardTerm(
        'fetch',
        'the first sheep in the goal',
        lambda step, weight: weight * step.after.inside.any(dim=-1).to(step.after.sheep.dtype),
        default=3.0,
    )
)


@TASKS.add
@dataclass(frozen=True)
class Fetch(Herding):
    """Fetch one sheep: starts as herding does, and ends with the first sheep in the goal."""

    name = 'fetch'
    meaning = 'bring the first sheep into the goal'
    world = {'n_sheep': 5, 'goal_radius': 9.0}  # noqa: RUF012
    terms = ('fetch',)
    metrics = METRICS_OF_FETCH
    achieved = 'fetched'
    ends = True

    patience: float = option(1.0, 'an option of its own', low=0.0)

    def terminated(self, state: WorldState) -> Tensor:
        """Return whether a sheep is in the goal, (...) bool."""
        return state.inside.any(dim=-1)
