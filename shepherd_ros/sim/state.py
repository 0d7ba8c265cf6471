"""State of the world at one step."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

from shepherd_ros.sim.vectors import masked_mean
import torch
from torch import Tensor


@dataclass(frozen=True)
class WorldState:
    """
    One world, or a batch of them in leading axes (...).

    Positions are in metres in the world frame. Absent agents (mask False) come after the present
    ones and stay where the goal started. At least one sheep and one shepherd are present.
    Nothing is changed in place; derived values are computed once.
    """

    seed: Tensor  # (...) int64: every random number of the episode follows from it
    step: Tensor  # (...) int64: steps since the start of the episode
    sheep: Tensor  # (..., N, 2) m
    heading: Tensor  # (..., N, 2) unit vectors
    sheep_mask: Tensor  # (..., N) bool
    shepherds: Tensor  # (..., H, 2) m
    shepherd_mask: Tensor  # (..., H) bool
    goal: Tensor  # (..., 2) m
    goal_radius: Tensor  # (...) m
    # (..., 2) m: the end of the goal's path, or the middle of its circle; by default the goal
    destination: Tensor = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        """Fill in the destination of a goal that stands."""
        if self.destination is None:
            object.__setattr__(self, 'destination', self.goal)

    @cached_property
    def center(self) -> Tensor:
        """Return the flock's center of mass, (..., 2) m."""
        return masked_mean(self.sheep, self.sheep_mask)

    @cached_property
    def flock_size(self) -> Tensor:
        """Return the number of sheep present, (...) int64."""
        return self.sheep_mask.sum(dim=-1)

    @cached_property
    def team_size(self) -> Tensor:
        """Return the number of shepherds present, (...) int64."""
        return self.shepherd_mask.sum(dim=-1)

    @cached_property
    def gap(self) -> Tensor:
        """Return the distance of each sheep to the goal's rim, negative inside; (..., N) m."""
        to_goal = torch.linalg.vector_norm(self.sheep - self.goal[..., None, :], dim=-1)
        return to_goal - self.goal_radius[..., None]

    @cached_property
    def inside(self) -> Tensor:
        """Return the mask of sheep in the goal, (..., N) bool."""
        return (self.gap <= 0) & self.sheep_mask

    def world(self, index: int | slice | Tensor) -> WorldState:
        """Return part of a batch, selected along its first axis."""
        return replace(self, **{f.name: getattr(self, f.name)[index] for f in fields(self)})

    def to(self, *args: object) -> WorldState:
        """Return the state with floating-point tensors converted as Tensor.to() does."""
        return replace(
            self,
            **{
                f.name: value.to(*args) if value.is_floating_point() else value
                for f in fields(self)
                for value in [getattr(self, f.name)]
            },
        )


def where(mask: Tensor, left: WorldState, right: WorldState) -> WorldState:
    """Return the left worlds where the mask (B,) is True, the right ones elsewhere."""
    chosen = {}
    for f in fields(left):
        a, b = getattr(left, f.name), getattr(right, f.name)
        chosen[f.name] = torch.where(mask.reshape(mask.shape + (1,) * (a.dim() - 1)), a, b)
    return WorldState(**chosen)


def stack(states: list[WorldState]) -> WorldState:
    """Return single worlds of equal sizes as one batch."""
    return WorldState(
        **{f.name: torch.stack([getattr(s, f.name) for s in states]) for f in fields(WorldState)}
    )
