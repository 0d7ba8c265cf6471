"""Replay of recorded episodes: states, metrics and tracks for pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from shepherd_ros.config import ConfigError
from shepherd_ros.recordings.episodes import Frame, RecordedEpisode
from shepherd_ros.sim.rollout import advance_to, EnvConfig, start
from shepherd_ros.sim.state import stack, WorldState
from shepherd_ros.sim.tasks import Task
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.view.track import EpisodeTrack
from shepherd_ros.wire.episode import Episode
import torch


def states_of(episode: RecordedEpisode, frames: Sequence[Frame] | None = None) -> WorldState:
    """
    Return the recorded states, or those of some frames, as a batch (T), exact to the last bit.

    A goal that was not recorded is at 0, 0. Raises ConfigError if the radius of the goal is not
    known.
    """
    states = []
    if not episode.goal_radius:
        raise ConfigError('goal_radius of an episode is not known: expected metres')
    for frame in episode.frames if frames is None else frames:
        goal = np.zeros(2) if frame.goal is None else frame.goal
        states.append(
            WorldState(
                seed=torch.tensor(episode.seed),
                step=torch.tensor(frame.step),
                sheep=_tensor(frame.sheep),
                heading=torch.from_numpy(exact_heading(frame.sheep_heading)),
                sheep_mask=torch.ones(episode.n_sheep, dtype=torch.bool),
                shepherds=_tensor(frame.shepherds),
                shepherd_mask=torch.ones(episode.n_shepherds, dtype=torch.bool),
                goal=_tensor(goal),
                goal_radius=torch.tensor(episode.goal_radius),
                destination=_tensor(goal if frame.destination is None else frame.destination),
            )
        )
    return stack(states)


def _tensor(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.asarray(values, np.float32))


_ULPS = np.arange(
    -4, 5, dtype=np.int32
)  # units in the last place that a unit vector may be too long
_ROUNDING = 1e-15  # of a direction on its way through a quaternion


def exact_heading(direction: np.ndarray) -> np.ndarray:
    """
    Return the headings in float32 that have these directions (K, 2) in float64; (K, 2).

    A pose keeps the direction of a heading and not its length, which float32 rounds to nearly 1.
    Of the float32 vectors about as long hardly two have the same direction (one heading in three
    million is not told from its neighbor), so it says which one it was.
    """
    swap = np.abs(direction[:, 1]) > np.abs(direction[:, 0])
    long, short = np.where(swap[:, None], direction[:, ::-1], direction).T
    short = np.where(np.abs(short) < _ROUNDING, 0.0, short)
    bits = long.astype(np.float32).view(np.int32)[:, None] + _ULPS
    candidates = bits.view(np.float32).astype(np.float64)
    exact = candidates * (short / long)[:, None]
    others = exact.astype(np.float32).astype(np.float64)
    error = np.maximum(np.abs(others - exact), _ROUNDING) / _ROUNDING
    best = (error + np.abs(np.hypot(candidates, others) - 1)).argmin(axis=1)
    row = np.arange(len(direction))
    headings = np.stack([candidates[row, best], others[row, best]], axis=-1)
    return np.where(swap[:, None], headings[:, ::-1], headings).astype(np.float32)


def task_of(episode: Episode) -> Task:
    """Return the task of a recorded episode, or raise ConfigError."""
    return WorldConfig.from_dict({'task': episode.world.get('task', {})}).task


def metrics_over_time(
    states: WorldState, episode_steps: int, task: Task | None = None
) -> dict[str, np.ndarray]:
    """Return the metrics of a task, by default herding, after each state (T), (T,) each."""
    world = WorldConfig() if task is None else WorldConfig(task=task)
    moment = start(states.world(0), EnvConfig(world=world))
    rows = [moment.metrics(episode_steps)]
    for t in range(1, len(states.step)):
        moment = advance_to(moment, states.world(t))
        rows.append(moment.metrics(episode_steps))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def ranges_of(episode: RecordedEpisode) -> np.ndarray | None:
    """Return the scans (T, H, C, R) m, inf for a missing one; None without any."""
    shapes = {scan.shape for frame in episode.frames for scan in frame.scans if scan is not None}
    if len(shapes) != 1:
        return None
    free = np.full(shapes.pop(), np.inf, np.float32)
    return np.array([[free if s is None else s for s in frame.scans] for frame in episode.frames])


def track_of(episode: RecordedEpisode, title: str, parting: int | None = None) -> EpisodeTrack:
    """Return the episode for pictures and animations, with the lidar of shepherd 0 if recorded."""
    states, ranges = states_of(episode), ranges_of(episode)
    return EpisodeTrack(
        times=np.array([frame.stamp_ns for frame in episode.frames]) * 1e-9,
        sheep=states.sheep.numpy(),
        shepherds=states.shepherds.numpy(),
        goal=states.goal.numpy(),
        goal_radius=float(states.goal_radius[0]),
        title=title,
        ranges=None if ranges is None else ranges[:, 0],
        channels=episode.channels,
        lidar_shepherd=0,
        parting=parting,
        words=task_of(episode).words,
    )
