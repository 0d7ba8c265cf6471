"""Base class and registry of tasks: what a team of shepherds has to do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from shepherd_ros.config import Config
from shepherd_ros.registry import Registry
from shepherd_ros.sim.metrics import Metric
from shepherd_ros.sim.rng import Stream, uniform
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor


class Task(Config):
    """
    A task: start, end, reward and metrics of its episodes; its options are those of its start.

    Functions get and return batches of worlds (...), as all laws do.
    """

    name: ClassVar[str]
    meaning: ClassVar[str]
    words: ClassVar[tuple[str, str, str]] = ('sheep', 'shepherd', 'goal')  # in pictures
    progress: ClassVar[str] = ''  # what a demo says of the moment, a format of its metrics
    flock: ClassVar[str] = 'strombom'  # flock model by default
    world: ClassVar[Mapping[str, Any]] = {}  # defaults of WorldConfig by path
    training: ClassVar[Mapping[str, Any]] = {}  # defaults of the training's task by name
    terms: ClassVar[tuple[str, ...]]  # of REWARD_TERMS that count without being asked for
    metrics: ClassVar[Registry[Metric]]
    achieved: ClassVar[str]  # of the metrics, by which with the return a training keeps the best
    ends: ClassVar[bool] = False  # whether states can be terminal

    def start(self, config: Any, seed: Tensor, dtype: torch.dtype) -> WorldState:
        """Return the first state of the episodes with these seeds (...) in a WorldConfig."""
        raise NotImplementedError

    def terminated(self, state: WorldState) -> Tensor:
        """Return the mask of terminal states, (...) bool; they are not bootstrapped."""
        return torch.zeros_like(state.step, dtype=torch.bool)

    def observed(self, state: WorldState) -> WorldState:
        """Return the perceived state as lidars see it, such as with another goal."""
        return state


def team_mask(config: Any, seed: Tensor) -> Tensor:
    """Return the mask of the shepherds that are present, as WorldConfig draws them; (..., H)."""
    m = config.n_shepherds
    zero, index = torch.zeros_like(seed), torch.arange(m, device=seed.device)
    fewest = config.spawn.fewest_shepherds or m
    spread = uniform(seed, zero, Stream.N_SHEPHERDS, index[:1], torch.float64)
    size = fewest + (spread * (m - fewest + 1)).long()  # (..., 1)
    return index < size


def drawn_radius(config: Any, seed: Tensor) -> Tensor:
    """Return the radius of the goal region, (...) m in float64."""
    index = torch.arange(1, device=seed.device)
    extra = uniform(seed, torch.zeros_like(seed), Stream.GOAL_RADIUS, index, torch.float64)
    return config.goal_radius + config.spawn.goal_radius_extra * extra[..., 0]


TASKS: Registry[type[Task]] = Registry('task')
