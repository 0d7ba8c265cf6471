"""Start of an episode."""

from __future__ import annotations

from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor


def spawn(config: WorldConfig, seed: Tensor, dtype: torch.dtype = torch.float32) -> WorldState:
    """Return the first state of the episodes with these seeds, as the task says; (...) int64."""
    return config.task.start(config, seed, dtype)
