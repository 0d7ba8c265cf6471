"""
Complete steps of a recorded episode: the scan and the command of each shepherd.

Learning from recordings starts here, from bags and from data sets built of them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from shepherd_ros.config import ConfigError
from shepherd_ros.recordings.episodes import Frame, RecordedEpisode
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS, ScanLayout
from shepherd_ros.wire.decode import Floats, Ranges

Refuse = Callable[[str, str, int], None]  # reason, place of the first, steps of single shepherds


@dataclass(frozen=True)
class Steps:
    """The complete steps (n) of an episode, by step and then by shepherd."""

    bag: str  # name of the bag
    episode: int  # which of the bag, counted from 0
    seed: int
    n_sheep: int
    n_shepherds: int
    dt: float  # s
    step: NDArray[np.int64]  # (n,)
    shepherd: NDArray[np.int64]  # (n,)
    lidar: NDArray[np.float32]  # (n, C, R) m, +inf for no return
    action: NDArray[np.float32]  # (n, 2) m/s, world frame
    channels: tuple[str, ...] = PAPER_CHANNELS  # C
    range_max: float = 0.0  # m, of the lidar; 0 if it is not known
    partial: bool = False  # states of the episode were not recorded
    task: str = ''  # what the team has to do, in words
    driver: NDArray[np.str_] = field(  # (n,) source of the action; (0,) if not recorded
        default_factory=lambda: np.zeros(0, np.str_)
    )
    home_distance: NDArray[np.float32] = field(  # (n,) from flock to goal [goal radii],
        default_factory=lambda: np.zeros(0, np.float32)  # (0,) without poses, as in a data set
    )

    def __len__(self) -> int:
        """Return the number of steps."""
        return len(self.step)

    def driven_by(self, drivers: Collection[str]) -> NDArray[np.bool_]:
        """Return the mask (n,) of the steps with one of these drivers; all if none is named."""
        if drivers and len(self.driver):
            return np.isin(self.driver, sorted(drivers))
        return np.full(len(self), not drivers)

    def with_context(self, drivers: Collection[str]) -> Steps:
        """Return all steps of each shepherd that has a step with one of these drivers."""
        chosen = np.isin(self.shepherd, self.shepherd[self.driven_by(drivers)])
        names = ['step', 'shepherd', 'lidar', 'action']
        names += [name for name in ('driver', 'home_distance') if len(getattr(self, name))]
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})

    @property
    def layout(self) -> ScanLayout:
        """Return channels and rays of the scans, 0 rays if there is no step."""
        return ScanLayout(self.channels, self.lidar.shape[-1])

    @property
    def where(self) -> str:
        """Return the name of the episode in messages."""
        return f'{self.bag}:{self.episode}'


def _meaning(task: str) -> str:
    """Return what a task asks of its team in words; the name of one that is not known here."""
    from shepherd_ros.sim.tasks import TASKS  # which loads torch

    return TASKS[task].meaning if task in TASKS else task


def steps_of(episode: RecordedEpisode, bag: str, number: int, refuse: Refuse) -> Steps:
    """
    Return the steps of an episode that have poses, scan and command of a shepherd.

    refuse(reason, place, steps) is called for the others. The last state has no successor, so it
    is no step. Raises ConfigError where the lidar changes within the episode.
    """
    place, team = f'{bag}:{number}', episode.n_shepherds
    range_max = _range_max(episode, place)
    _refuse_holes([frame.step for frame in episode.frames], team, place, refuse)
    steps: list[tuple[int, int, Ranges, NDArray[np.float32]]] = []
    has_drivers = any(frame.drivers for frame in episode.frames)
    drivers: list[str] = []
    distances: list[float] = []
    for frame in episode.frames[:-1]:
        for h in range(team):
            scan, command = frame.scans[h], _single(frame.commands[h])
            reason = _fault(scan, command)
            if reason or scan is None or command is None:
                refuse(reason, f'{place}, step {frame.step}, shepherd_{h}', 1)
                continue
            if steps and scan.shape != steps[0][2].shape:
                raise ConfigError(
                    f'{place}, step {frame.step}, shepherd_{h}: a scan of {scan.shape[-1]} rays, '
                    f'expected {steps[0][2].shape[-1]} as before; record one lidar at a time'
                )
            steps.append((frame.step, h, scan, command))
            distances.append(_home_distance(frame, episode.goal_radius))
            drivers.append((frame.drivers[h] if len(frame.drivers) > h else None) or '')
    empty = np.zeros((0, len(episode.channels), 0), np.float32)
    return Steps(
        bag=bag,
        episode=number,
        seed=episode.seed,
        n_sheep=episode.n_sheep,
        n_shepherds=team,
        dt=episode.dt,
        step=np.array([row[0] for row in steps], np.int64),
        shepherd=np.array([row[1] for row in steps], np.int64),
        channels=episode.channels,
        range_max=range_max,
        partial=not episode.whole,
        task=_meaning(episode.task),
        lidar=np.stack([row[2] for row in steps]).astype(np.float32) if steps else empty,
        action=np.array([row[3] for row in steps], np.float32).reshape(-1, 2),
        driver=np.array(drivers if has_drivers else [], np.str_),
        home_distance=np.array(distances, np.float32),
    )


def _home_distance(frame: Frame, goal_radius: float) -> float:
    """Return the distance of the flock's middle from the goal [goal radii], NaN without a goal."""
    if frame.goal is None:
        return np.nan
    return float(np.linalg.norm(frame.sheep.mean(axis=0) - frame.goal)) / goal_radius


def _range_max(episode: RecordedEpisode, place: str) -> float:
    """Return the range of the lidar [m], 0 without scans, or raise ConfigError."""
    lidars = set[tuple[float, float]]().union(*(frame.lidars for frame in episode.frames))
    for _, angle_min in lidars:
        if angle_min:
            raise ConfigError(f'{place}: scans have angle_min {angle_min} rad, expected 0')
    if len(lidars) > 1:
        ranges = sorted(range_max for range_max, _ in lidars)
        raise ConfigError(f'{place}: scans have range_max {ranges} m, expected one lidar')
    return next(iter(lidars), (0.0, 0.0))[0]


def _single(command: Floats | None) -> NDArray[np.float32] | None:
    """Return a command (2,) m/s in single precision, None without one."""
    with np.errstate(over='ignore'):
        return None if command is None else command.astype(np.float32)


def _fault(scan: Ranges | None, command: NDArray[np.float32] | None) -> str:
    """Return the fault of the step of a shepherd, empty without one."""
    if command is None:
        return 'no command'
    if not np.isfinite(command).all():
        return 'a command that is not finite'
    if scan is None or not scan.size:
        return 'no scan'
    return 'a scan with NaN' if np.isnan(scan).any() else ''


def _refuse_holes(steps: list[int], team: int, place: str, refuse: Refuse) -> None:
    """Refuse the steps between the first state and the last that lack poses."""
    missing = steps[-1] - steps[0] + 1 - len(steps) if steps else 0
    if missing:
        first = next(a + 1 for a, b in pairwise(steps) if b > a + 1)
        refuse('no poses', f'{place}, step {first}', missing * team)
