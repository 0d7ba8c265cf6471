"""Counterfactual episodes: recorded up to a state, then under another controller."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
from shepherd_ros.controllers.controller import Controller, Memory
from shepherd_ros.recordings.episodes import Frame, RecordedEpisode
from shepherd_ros.recordings.record import drive, EpisodeBag
from shepherd_ros.recordings.replay import metrics_over_time, states_of, task_of
from shepherd_ros.recordings.replay_check import law_commands
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS
from shepherd_ros.sim.perception import perceive
from shepherd_ros.sim.rollout import advance_to, EnvConfig, Moment, start
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.world import WorldConfig


def record_future(
    episode: RecordedEpisode,
    at: int,
    controller: Controller,
    noise_std: float,
    folder: Path,
    on_step: Callable[[int], None] = lambda worlds: None,
) -> bool:
    """
    Write the episode as recorded until frame `at`, then as it goes on under a controller.

    The goal moves as recorded. Returns whether the controller goes on with its memory of the
    past, as of memory_at(). The folder must not exist; raises BagError.
    """
    world = WorldConfig.from_dict(episode.world)
    config = EnvConfig(noise_std=noise_std, world=world, lidar=lidar_of(episode))
    states = states_of(episode)
    memory, continues = memory_at(episode, states, at, controller, noise_std)
    moment = start(states.world(slice(0, 1)), config)
    bag = EpisodeBag(folder, replace(episode, world=world.to_dict(), end=''), 'none')
    with closing(bag.writer):
        for t, frame in enumerate(episode.frames[:at]):
            values = moment.metrics()
            commands = [None if c is None else c.tolist() for c in frame.commands]
            row = {name: float(value[0]) for name, value in values.items()}
            ranges, state, before = (
                recorded_or_cast_ranges(frame, moment),
                moment.state,
                moment.before,
            )
            bag.step(state.world(0), before.world(0), ranges, commands, row, config.lidar)
            moment = advance_to(moment, states.world(slice(t + 1, t + 2)))
            on_step(1)
        goals = {frame.step: goal for frame, goal in zip(episode.frames, states.goal, strict=True)}
        drive([bag], controller, moment, memory, goals, on_step)
    return continues


def memory_at(
    episode: RecordedEpisode, states: WorldState, at: int, controller: Controller, noise_std: float
) -> tuple[Memory, bool]:
    """
    Return the memory of a controller at frame `at`, and whether it is of the past.

    It is if each command until then is exactly that of the controller, begun at the first state;
    else the controller begins here.
    """
    past = law_commands(states.world(slice(0, at + 1)), controller, noise_std)
    for frame, (memory, command) in zip(episode.frames, past, strict=False):
        if frame is episode.frames[at]:
            return memory, at > 0
        recorded = [np.full(2, np.nan) if c is None else c for c in frame.commands]
        if not np.array_equal(recorded, command.double().numpy()):
            break
    return controller.begin(perceive(states.world(slice(at, at + 1)), noise_std)), False


def lidar_of(episode: RecordedEpisode) -> LidarConfig:
    """Return the lidar of the scans, the default one without scans."""
    rays = {s.shape[-1] for frame in episode.frames for s in frame.scans if s is not None}
    reach = {range_max for frame in episode.frames for range_max, _ in frame.lidars}
    others = ','.join(set(episode.channels) - set(PAPER_CHANNELS))
    if len(rays) != 1 or len(reach) != 1:
        return LidarConfig()
    return LidarConfig(n_rays=rays.pop(), range_max=reach.pop(), others=others)


def recorded_or_cast_ranges(frame: Frame, moment: Moment) -> list[np.ndarray]:
    """Return the scans (C, R) m of a world (1), recorded ones or, where missing, cast ones."""
    recorded = [s for s in frame.scans if s is not None]
    if len(recorded) == len(frame.scans):
        return recorded
    cast = moment.ranges[0].numpy()
    return [c if s is None else s for s, c in zip(frame.scans, cast, strict=True)]


def metrics_table(recorded: RecordedEpisode, future: RecordedEpisode, name: str) -> str:
    """Return the metrics of two episodes after their last common step, as a Markdown table."""
    common = {frame.step for frame in recorded.frames} & {frame.step for frame in future.frames}
    last = max(common)
    task, columns = task_of(recorded), []
    for episode in (recorded, future):
        curves = metrics_over_time(states_of(episode), episode.episode_steps, task)
        place = [frame.step for frame in episode.frames].index(last)
        columns.append({metric: values[place] for metric, values in curves.items()})
    lines = [f'| after {last} steps | recorded | {name} | unit |', '|:--|--:|--:|:--|']
    for metric in task.metrics.values():
        values = ' | '.join(f'{column[metric.name]:.4g}' for column in columns)
        lines.append(f'| {metric.name} | {values} | {metric.unit} |')
    return '\n'.join(lines) + '\n'
