"""Base class and registry of controllers."""

from __future__ import annotations

from typing import Any, ClassVar

from shepherd_ros.config import Config, ConfigError
from shepherd_ros.registry import Registry
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import wrap
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor

Memory = dict[str, Tensor]


class Controller:
    """
    A law from perceived state to velocities, without hidden state.

    Its state within an episode is a Memory: tensors with the state's leading axes. Random numbers
    come from the state's seed and step, so the same state gives the same commands.
    """

    name: ClassVar[str]
    config_type: ClassVar[type[Config]]
    executable: ClassVar[str] = 'controller'  # of its node; this one runs any of them by name
    label: ClassVar[str] = ''  # in tables and figures; empty: its name
    order: ClassVar[int] = 50  # in tables and figures: policies 0, baselines, these, floors 90
    style: ClassVar[tuple[str, Any, str] | None] = None  # colour, line, marker; None: a free one

    def __init__(self, config: Any, world: WorldConfig) -> None:
        """Store the configuration, and that of the world."""
        self.config = config
        self.world = world

    @classmethod
    def in_preset(cls, config: Any, world: WorldConfig, preset: str) -> Controller:
        """Return the controller of a world of a preset, which may have options for its parts."""
        return cls(config, world)

    @classmethod
    def options_of(cls, text: str) -> dict[str, Any]:
        """Return the options that the text after its name and a colon gives, or ConfigError."""
        own = (name for name, kind in CONTROLLERS.items() if 'options_of' in vars(kind))
        raise ConfigError(
            f'controller is {f"{cls.name}:{text}"!r}: expected {cls.name} alone; a colon follows '
            f'only {", ".join(sorted(own))}'
        )

    def begin(self, state: WorldState) -> Memory:
        """Return the memory at the first state of an episode."""
        return {}

    def act(self, state: WorldState, memory: Memory) -> tuple[Tensor, Memory]:
        """Return commands (..., H, 2) m/s, world frame, at most the top speed, and memory."""
        raise NotImplementedError


CONTROLLERS: Registry[type[Controller]] = Registry('controller')


def places_on_arc(around: Tensor, spacing: Tensor, mask: Tensor) -> Tensor:
    """
    Return a place for each shepherd on an arc centred on 0, (..., H) rad.

    around (..., H) rad are the shepherds' bearings from the arc's middle, spacing (..., 1) rad is
    the angle between places, mask (..., H) bool marks the shepherds that take part. Places are
    assigned in order of bearing, up to the cyclic shift with the least sum of turns: no two cross,
    and shepherds on the far side keep their side.
    """
    size = around.shape[-1]
    index = torch.arange(size, device=around.device)
    own, other = around[..., :, None], around[..., None, :]
    before = (other < own) | ((other == own) & (index[None, :] < index[:, None]))
    rank = (before & mask[..., None, :]).sum(dim=-1)
    count = mask.sum(dim=-1, keepdim=True).clamp(min=1)  # (..., 1)
    shifted = (rank[..., None, :] + index[:, None]) % count[..., None]  # (..., shift, H)
    place = (shifted - (count[..., None] - 1) / 2) * spacing[..., None]
    turn = wrap(place - around[..., None, :]).abs() * mask[..., None, :]
    # shifts that differ by rounding only are the same: the first of them counts
    total = (turn.sum(dim=-1) * 1e4).round()
    best = total.argmin(dim=-1)[..., None, None].expand(*rank.shape[:-1], 1, size)
    return place.gather(-2, best)[..., 0, :]
