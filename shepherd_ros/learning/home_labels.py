"""Commands of a teacher where the flock is home, for a learner that drives by reward."""

from __future__ import annotations

from typing import Any

from shepherd_ros.controllers.composite import HOME
from shepherd_ros.controllers.controller import Controller, Memory
from shepherd_ros.learning.teachers import make_teacher
from shepherd_ros.sim.observation import rotate_by_ray
from shepherd_ros.sim.rollout import Moment
import torch
from torch import Tensor


class HomeLabels:
    """
    Labels of the decisions of groups of worlds, none without a teacher.

    The teacher sees the true state at each decision. A flock is home while a composite says so,
    with any other teacher while its middle is in the goal.
    """

    def __init__(self, teacher: str, groups: int, team: torch.Size, decisions: int) -> None:
        """Create empty labels for a number of decisions; team is (B, H)."""
        self.name = teacher
        self.teachers: list[Controller | None] = [None] * groups
        self.memories: list[Memory] = [{} for _ in range(groups)]
        shape = (groups, decisions, *team) if teacher else (0,)
        self.label = torch.zeros(*shape, 2)
        self.home = torch.zeros(shape, dtype=torch.bool)
        self.n_rays = 0

    def begin(self, group: int, moment: Moment) -> None:
        """Create the teacher of a group's world, at the start of an episode."""
        if not self.name:
            return
        self.n_rays = moment.config.lidar.n_rays
        teacher = make_teacher(self.name, moment.config.world)
        self.teachers[group], self.memories[group] = teacher, teacher.begin(moment.state)

    def add(self, group: int, decision: int, moment: Moment) -> None:
        """Label the state of a group at a decision."""
        teacher, state = self.teachers[group], moment.state
        if teacher is None:
            return
        label, memory = teacher.act(state, self.memories[group])
        distance = torch.linalg.vector_norm(state.center - state.goal, dim=-1)
        home = memory.get(HOME, distance <= state.goal_radius)
        self.memories[group] = memory
        self.label[group, decision] = label.to(self.label)
        self.home[group, decision] = home[:, None].to(self.home.device)

    def of(self, index: tuple[Tensor, ...], first: Tensor) -> tuple[Tensor | None, Tensor | None]:
        """Return labels (n, 2) m/s relative to the first ray, and where they count, (n,) bool."""
        if not self.name:
            return None, None
        where = tuple(part.to(self.label.device) for part in index)
        label = rotate_by_ray(self.label[where].to(first.device), -first, self.n_rays)
        return label, self.home[where].to(first.device)

    def state_dict(self) -> dict[str, Any]:
        """Return the memories of the teachers."""
        return {'memories': self.memories}

    def load_state_dict(self, state: dict[str, Any], moments: list[Moment]) -> None:
        """Restore the state that state_dict() returned, in the worlds of the groups."""
        for group, moment in enumerate(moments):
            self.begin(group, moment)
        self.memories = [dict(memory) for memory in state['memories']]
