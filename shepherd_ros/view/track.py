"""Track of an episode for pictures: positions over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from shepherd_ros.config import ConfigError
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS

_Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class EpisodeTrack:
    """
    Positions in metres in the world frame at T times, and what one shepherd's lidar saw.

    Channels and rays are those of sim.lidar: sheep, shepherds, goal; ray k points along
    2 pi k / R, counter-clockwise from +x; +inf is a free ray.
    """

    times: _Array  # (T,) s
    sheep: _Array  # (T, N, 2) m
    shepherds: _Array  # (T, H, 2) m
    goal: _Array  # (T, 2) m
    goal_radius: float  # m
    title: str = ''
    ranges: _Array | None = None  # (T, C, R) m
    channels: tuple[str, ...] = PAPER_CHANNELS  # C of them
    lidar_shepherd: int = 0  # whose lidar it is
    words: tuple[str, str, str] = ('sheep', 'shepherd', 'goal')  # many, one and the disc
    parting: int | None = None  # step at which another future begins, to be marked

    def __post_init__(self) -> None:
        """Take anything that numpy can read; check shapes and that numbers are finite."""
        steps = len(self.times)
        shapes = {
            'times': (steps,),
            'sheep': (steps, None, 2),
            'shepherds': (steps, None, 2),
            'goal': (steps, 2),
            'ranges': (steps, len(self.channels), None),
        }
        for name, shape in shapes.items():
            if getattr(self, name) is None:
                continue
            value = np.asarray(getattr(self, name), dtype=np.float64)
            object.__setattr__(self, name, value)
            _check(name, value, shape)
        if not (np.isfinite(self.goal_radius) and self.goal_radius > 0):
            raise ConfigError(f'goal_radius is {self.goal_radius}: expected metres above 0')
        if not 0 <= self.lidar_shepherd < self.shepherds.shape[1]:
            raise ConfigError(
                f'lidar_shepherd is {self.lidar_shepherd}: expected an index below the '
                f'{self.shepherds.shape[1]} shepherds'
            )

    @property
    def center(self) -> _Array:
        """Return the flock's center of mass, (T, 2) m."""
        return self.sheep.mean(axis=1)

    @property
    def herds(self) -> bool:
        """Return whether sheep belong into the goal; else those in it are breaches."""
        return self.words[0] == 'sheep'

    @property
    def middle(self) -> _Array:
        """Return what a picture follows: the flock's center, or the payload's; (T, 2) m."""
        return self.center if self.herds else self.goal

    def breaches(self, step: int) -> int:
        """Return the number of steps until then with somebody in the goal."""
        return int((self.in_goal[: step + 1] > 0).sum())

    @property
    def in_goal(self) -> NDArray[np.int64]:
        """Return the number of sheep in the goal, (T,)."""
        distance = np.linalg.norm(self.sheep - self.goal[:, None], axis=-1)
        return (distance <= self.goal_radius).sum(axis=1)


def _check(name: str, value: _Array, shape: tuple[int | None, ...]) -> None:
    """Raise ConfigError unless value has the shape (None: any length but 0) and usable numbers."""
    fits = value.ndim == len(shape) and value.size > 0
    if not fits or any(e not in (None, g) for e, g in zip(shape, value.shape, strict=True)):
        expected = ', '.join('any' if length is None else str(length) for length in shape)
        raise ConfigError(f'{name} has shape {value.shape}: expected ({expected}), not empty')
    usable = ~np.isnan(value) if name == 'ranges' else np.isfinite(value)
    if not usable.all():
        raise ConfigError(f'{name} has {(~usable).sum()} numbers that are not finite')
