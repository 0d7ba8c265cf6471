"""What a training loop asks of PPO, cloning and DAgger."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from shepherd_ros.policy.policy import Policy
import torch


class Trainer(Protocol):
    """What learns, update by update, and goes on from a state."""

    config: Any  # with eval_episodes, eval_steps and the task
    eval_freq: int  # updates from one evaluation to the next
    policy: Policy
    dtype: torch.dtype
    progress: dict[str, Any]  # `updates`, `samples` and what else a line begins with

    def share(self) -> float:
        """Return which share of the whole is done; at least 1 at the end."""

    def update(self, stopping: Callable[[], bool]) -> dict[str, float] | None:
        """Learn once; return logged scalars, None if it stopped in between as it was told to."""

    def averaged(self) -> Policy:
        """Return the policy to evaluate and to keep."""

    def state_dict(self) -> dict[str, Any]:
        """Return the state of the training."""

    def load_state_dict(self, kept: dict[str, Any]) -> None:
        """Restore the state that state_dict() returned."""
