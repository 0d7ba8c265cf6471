"""The interface of PPO, cloning and DAgger for the training loop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from shepherd_ros.policy.policy import Policy
import torch


class Trainer(Protocol):
    """A trainer that runs update by update, and resumes from a state."""

    config: Any  # with the evaluation and the task
    eval_freq: int  # updates from one evaluation to the next
    policy: Policy
    dtype: torch.dtype
    progress: dict[str, Any]  # `updates`, `samples` and other fields at the front of a line

    def share(self) -> float:
        """Return the fraction of the training that is done; at least 1 at the end."""

    def update(self, stopping: Callable[[], bool]) -> dict[str, float] | None:
        """Run one update; return logged scalars, None if stopping() interrupted it."""

    def averaged(self) -> Policy:
        """Return the policy to evaluate and to keep."""

    def evaluate(self, policy: Policy) -> dict[str, float]:
        """Return the results of a policy; `score` is that by which one is kept."""

    def state_dict(self) -> dict[str, Any]:
        """Return the state of the training."""

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state that state_dict() returned."""
