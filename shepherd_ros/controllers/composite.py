"""
The composite: one controller drives the flock home, another holds it there.

Both see every state, so that each remembers what it would remember alone; the commands are those
of one of them. The flock is home once its middle is near the goal, and away again once it is
farther off than that, so that the two do not alternate at one distance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from shepherd_ros.config import Config, ConfigError, option, read
from shepherd_ros.controllers.controller import Controller, CONTROLLERS, Memory
from shepherd_ros.sim.presets import PRESETS
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.world import WorldConfig
import torch
from torch import Tensor

ROLES = ('drive', 'hold')
HOME = 'home'  # in the memory: whether the flock is home, (...) bool
WORD = 'composite:DRIVE,HOLD or composite:DRIVE,HOLD,HOME_WITHIN,AWAY_BEYOND'


@dataclass(frozen=True)
class CompositeConfig(Config):
    """Options of the composite; all are choices."""

    drive: str = option('strombom', 'controller that drives; a policy as policy:CHECKPOINT')
    hold: str = option('drover', 'controller that holds the flock in the goal; the same')
    home_within: float = option(
        0.85, 'the flock is home with its middle so near the goal [goal radii]', low=0.0
    )
    away_beyond: float = option(
        1.8, 'and away again with it farther than this [goal radii]', low=0.0
    )

    def __post_init__(self) -> None:
        """Check each field, that parts are no composites, and the order of the distances."""
        super().__post_init__()
        if self.home_within > self.away_beyond:
            raise ConfigError(
                f'home_within is {self.home_within}: expected at most away_beyond, '
                f'{self.away_beyond}'
            )
        for name in ROLES:
            word = getattr(self, name)
            if word.partition(':')[0] == CompositeController.name:
                raise ConfigError(f'{name} is {word!r}: expected one that is not composite')


def controller_named(word: str, world: WorldConfig, preset: str = 'default') -> Controller:
    """Return a controller by its word, such as policy:CHECKPOINT, with options of a preset."""
    name, colon, text = word.partition(':')
    kind = CONTROLLERS[name]
    options = dict(PRESETS[preset].controllers.get(name, {}))
    options |= kind.options_of(text) if colon else {}
    return kind.in_preset(kind.config_type(**options), world, preset)


@CONTROLLERS.add
class CompositeController(Controller):
    """Drives with one controller until the flock is home, and holds it there with another."""

    name = 'composite'
    config_type = CompositeConfig
    executable = 'composite'
    order = 13

    def __init__(
        self,
        config: CompositeConfig,
        world: WorldConfig,
        drive: Controller | None = None,
        hold: Controller | None = None,
    ) -> None:
        """Use the two controllers, or create those that the configuration names."""
        super().__init__(config, world)
        self.drive = drive or controller_named(config.drive, world)
        self.hold = hold or controller_named(config.hold, world)

    @classmethod
    def in_preset(cls, config: Any, world: WorldConfig, preset: str) -> Controller:
        """Return the controller, whose two parts have the options of a preset."""
        return cls.made_of(config, world, partial(controller_named, world=world, preset=preset))

    @classmethod
    def made_of(
        cls, config: CompositeConfig, world: WorldConfig, make: Callable[[str], Controller]
    ) -> Controller:
        """Return the controller with the parts that make(word) returns for their words."""
        return cls(config, world, *(make(getattr(config, role)) for role in ROLES))

    @classmethod
    def options_of(cls, text: str) -> dict[str, Any]:
        """Return the options of DRIVE,HOLD with or without the two distances."""
        names = (*ROLES, 'home_within', 'away_beyond')
        values = text.split(',')
        if len(values) not in (2, 4) or not all(values):
            raise ConfigError(f'controller is {f"{cls.name}:{text}"!r}: expected {WORD}')
        distances = {k: read(k, v, 1.0) for k, v in zip(names[2:], values[2:], strict=False)}
        return {'drive': values[0], 'hold': values[1], **distances}

    def begin(self, state: WorldState) -> Memory:
        """Return the memories of both, and that the flock is away."""
        memory: Memory = {HOME: torch.zeros_like(state.step, dtype=torch.bool)}
        for name, part in self._parts():
            memory |= {f'{name}.{key}': value for key, value in part.begin(state).items()}
        return memory

    def act(self, state: WorldState, memory: Memory) -> tuple[Tensor, Memory]:
        """Return commands (..., H, 2) m/s of the one whose turn it is, and memory."""
        distance = torch.linalg.vector_norm(state.center - state.goal, dim=-1)
        limit = torch.where(memory[HOME], self.config.away_beyond, self.config.home_within)
        home = distance <= limit * state.goal_radius
        commands, after = [], {HOME: home}
        for name, part in self._parts():
            prefix = f'{name}.'
            own = {k.removeprefix(prefix): v for k, v in memory.items() if k.startswith(prefix)}
            command, own = part.act(state, own)
            commands.append(command)
            after |= {prefix + key: value for key, value in own.items()}
        drive, hold = commands
        return torch.where(home[..., None, None], hold, drive), after

    def _parts(self) -> tuple[tuple[str, Controller], tuple[str, Controller]]:
        """Return the two controllers by the names of their options."""
        return (('drive', self.drive), ('hold', self.hold))
