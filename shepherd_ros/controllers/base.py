"""What a controller is."""

from __future__ import annotations

from typing import Any, ClassVar

from shepherd_ros.config import Config
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor

Memory = dict[str, Tensor]


class Controller:
    """
    A law from perceived state to velocities, without hidden state.

    What it remembers within an episode is a Memory: tensors with the state's leading axes. Random
    numbers come from the state's seed and step, so the same state gives the same answer.
    """

    name: ClassVar[str]
    config_type: ClassVar[type[Config]]

    def __init__(self, config: Any, world: WorldConfig) -> None:
        """Keep the configuration, and that of the world to herd in."""
        self.config = config
        self.world = world

    def begin(self, seen: WorldState) -> Memory:
        """Return the memory at the first state of an episode."""
        return {}

    def act(self, seen: WorldState, memory: Memory) -> tuple[Tensor, Memory]:
        """Return commands (..., H, 2) m/s, world frame, at most the top speed; and memory."""
        raise NotImplementedError


def rank(key: Tensor, mask: Tensor) -> Tensor:
    """Return the place of each item in ascending order of key, ties by index; (..., H)."""
    index = torch.arange(key.shape[-1], device=key.device)
    mine, other = key[..., :, None], key[..., None, :]
    before = (other < mine) | ((other == mine) & (index[None, :] < index[:, None]))
    return (before & mask[..., None, :]).sum(dim=-1)
