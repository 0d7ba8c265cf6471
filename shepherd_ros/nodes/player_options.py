"""Options of the player on its command line."""

from __future__ import annotations

from dataclasses import dataclass
import math
from pathlib import Path
from typing import Annotated

from shepherd_ros.config import ConfigError
import tyro


@dataclass(frozen=True)
class PlayerOptions:
    """Play a bag back on its topics."""

    bag: tyro.conf.Positional[Path]
    """Folder of a bag, or one .mcap, .db3 or .bag file."""
    rate: Annotated[float, tyro.conf.arg(aliases=['-r'])] = 1.0
    """Pace; 2 is twice as fast."""
    topics: tuple[str, ...] = ()
    """Topics to play, all by default."""
    start_offset: float = 0.0
    """Begin so many seconds after the first message; what is latched is played all the same."""
    until: float = 0.0
    """End so many seconds after the first message; 0: at the end."""
    loop: Annotated[bool, tyro.conf.arg(aliases=['-l'])] = False
    """Begin anew at the end."""
    clock: float = 0.0
    """Publish /clock at this rate [Hz of wall time], if it is not among what is played."""
    wait: float = 0.0
    """Wait until every topic has a reader, at most so many seconds."""
    start_paused: Annotated[bool, tyro.conf.arg(aliases=['-p'])] = False
    """Begin paused."""

    def check(self) -> None:
        """Raise ConfigError for numbers out of range."""
        if not 0 < self.rate < math.inf:
            raise ConfigError(f'--rate is {self.rate}: expected a number above 0, such as 1.0')
        for name in ('start_offset', 'until', 'clock', 'wait'):
            if not 0 <= getattr(self, name) < math.inf:
                value = getattr(self, name)
                raise ConfigError(f'--{name.replace("_", "-")} is {value}: expected 0 or more')
