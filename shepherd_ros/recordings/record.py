"""Recording of episodes of the environment as bags, as from a running stack."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
import shutil

import numpy as np
from shepherd_ros.controllers.controller import Controller, Memory
from shepherd_ros.recordings.recording_writer import offered_qos, RecordingWriter
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.rollout import advance, EnvConfig, Moment, start
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import unit
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.wire.encode import (
    encode_clock,
    encode_command,
    encode_goal,
    encode_goal_poses,
    encode_number,
    encode_poses,
    encode_scan,
    encode_text,
)
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.topics import (
    CLOCK,
    COMMANDS,
    contract,
    EPISODE,
    GOAL,
    GOAL_POSES,
    metric_topic,
    row_of,
    scan_topic,
    SHEEP_POSES,
    SHEPHERD,
    SHEPHERD_POSES,
    WORLD_FRAME,
)
import torch
from torch import Tensor


class EpisodeBag:
    """The bag of one episode: the topics of flock_sim, lidars, controller and metrics."""

    def __init__(self, folder: Path, episode: Episode, compression: str) -> None:
        """Open a bag in a folder that does not exist."""
        self.episode = episode
        self.writer = RecordingWriter(folder, compression=compression)
        self.now_ns = 0
        self.goal: list[float] = []

    def put(
        self, topic: str, content: bytes, shepherd: int | None = None, namespace: str = ''
    ) -> None:
        """Write a message of a topic of the contract at the present time."""
        row, profiles = row_of(topic), contract()[1]
        name = f'{namespace}/' + topic.format(h=shepherd).lstrip('/')
        self.writer.add_topic(name, row.type, [offered_qos(profiles[row.profile])])
        self.writer.write(name, content, self.now_ns, self.now_ns)

    def step(
        self,
        state: WorldState,
        before: WorldState,
        ranges: Sequence[np.ndarray | None],
        commands: Sequence[Sequence[float] | None],
        metrics: Mapping[str, float],
        lidar: LidarConfig,
        labels: tuple[str, Sequence[Sequence[float]]] = ('', ()),
    ) -> None:
        """
        Write a state with its scans, commands and metrics.

        The state before gives the shepherds' headings; ranges (C, R) m and commands (2,) m/s are
        those of each shepherd, and so are labels, in a namespace: another controller's commands.
        """
        episode = self.episode
        frame, team = episode.frame_id, episode.n_shepherds
        ns = episode.start_ns + int(state.step) * episode.dt_ns
        first, self.now_ns = self.now_ns == 0, ns
        if first:
            self.put(EPISODE, encode_text(episode.to_json()))
        if self.goal != state.goal.tolist():
            self.goal = state.goal.tolist()
            self.put(GOAL, encode_goal(ns, frame, *self.goal))
        if episode.goal_moves:
            goal, destination = state.goal.numpy(), state.destination.numpy()
            self.put(GOAL_POSES, encode_goal_poses(ns, frame, goal, destination))
        self.put(CLOCK, encode_clock(ns))
        heading_of_shepherds = unit(state.shepherds - before.shepherds)
        for name, position, heading in (
            (SHEPHERD_POSES, state.shepherds[:team], heading_of_shepherds[:team]),
            (SHEEP_POSES, state.sheep, state.heading),
        ):
            self.put(name, encode_poses(ns, frame, position.numpy(), heading.numpy()))
        names = lidar.layout.channels
        for h, channels in enumerate(ranges[:team]):
            for name, values in zip(names, () if channels is None else channels, strict=False):
                content = encode_scan(
                    ns, SHEPHERD.format(h=h), values, lidar.range_max, episode.dt
                )
                self.put(scan_topic(name), content, h)
        for h, command in enumerate(commands[:team]):
            if command is not None:
                self.put(COMMANDS, encode_command(ns, frame, *command), h)
        for h, command in enumerate(labels[1][:team]):
            content = encode_command(ns, frame, *command)
            self.put(COMMANDS, content, h, f'/{labels[0]}')
        for name, value in metrics.items():
            self.put(metric_topic(name), encode_number(value))

    def announce_end(self, end: str) -> None:
        """Write how the episode has ended; later states are left out."""
        self.episode = replace(self.episode, end=end)
        self.put(EPISODE, encode_text(self.episode.to_json()))


def episode_folder(out: Path, seed: int) -> Path:
    """Return the folder of the bag of an episode."""
    return out / f'episode_{seed:06d}'


def record_episodes(
    config: EnvConfig,
    controller: Controller,
    seeds: range,
    out: Path,
    compression: str = 'none',
    on_step: Callable[[int], None] = lambda worlds: None,
) -> None:
    """
    Write the episodes with consecutive seeds, one bag each, all at the same time.

    A bag gets its name when it is complete; on_step(worlds) is called after each step.
    """
    world = config.world
    moment = start(spawn(world, torch.arange(seeds.start, seeds.stop)), config)
    bags = open_bags(out, world, moment.state, compression)
    drive(bags, controller, moment, controller.begin(moment.perceived), {}, on_step)
    close_bags(out, bags)


def open_bags(
    out: Path, world: WorldConfig, first: WorldState, compression: str
) -> list[EpisodeBag]:
    """Return an open bag for each world (B), with a hidden name until close_bags()."""
    bags = []
    for k, seed in enumerate(first.seed.tolist()):
        folder = out / f'.{episode_folder(out, seed).name}'
        shutil.rmtree(folder, ignore_errors=True)  # left by a run that was killed
        bags.append(EpisodeBag(folder, describe_episode(world, first.world(k), seed), compression))
    return bags


def close_bags(out: Path, bags: Sequence[EpisodeBag]) -> None:
    """Close bags and rename them by their seeds."""
    for bag in bags:
        bag.writer.close()
        bag.writer.folder.rename(episode_folder(out, bag.episode.seed))


def write_moment(
    bags: Sequence[EpisodeBag],
    moment: Moment,
    command: Tensor | None = None,
    labels: tuple[str, Tensor] | None = None,
) -> None:
    """
    Write a moment of worlds (B) into the bag of each.

    command (B, H, 2) m/s is that of the moment, None after the last step; labels, in a namespace,
    are another controller's commands.
    """
    ranges, lidar = moment.ranges.numpy(), moment.config.lidar
    values = moment.metrics(bags[0].episode.episode_steps)
    for k, bag in enumerate(bags):
        if bag.episode.end:
            continue
        bag.step(
            moment.state.world(k),
            moment.before.world(k),
            ranges[k],
            [] if command is None else command[k].tolist(),
            {name: float(value[k]) for name, value in values.items()},
            lidar,
            ('', ()) if labels is None else (labels[0], labels[1][k].tolist()),
        )
        if moment.config.world.task.ends and moment.ended[k]:
            bag.announce_end('terminated' if moment.terminated[k] else 'truncated')


def drive(
    bags: Sequence[EpisodeBag],
    controller: Controller,
    moment: Moment,
    memory: Memory,
    goals: Mapping[int, Tensor],
    on_step: Callable[[int], None] = lambda worlds: None,
) -> None:
    """
    Run a controller to the end of the episode, and write each world (B) into its bag.

    goals (2,) m are positions to which the goal moves, by step; on_step(worlds) is called after
    each step.
    """
    last = moment.config.world.episode_steps
    for step in range(int(moment.state.step[0]), last + 1):
        command, memory = controller.act(moment.perceived, memory)
        write_moment(bags, moment, command)
        if moment.config.world.task.ends and moment.ended.all():
            break
        if step < last:
            moment = advance(moment, command, goals.get(step + 1))
        on_step(len(bags))


def describe_episode(world: WorldConfig, first: WorldState, seed: int) -> Episode:
    """Return the description of an episode, as flock_sim publishes it for its first one."""
    return Episode(
        number=0,
        seed=seed,
        start_ns=round(world.dt * 1e9),
        n_sheep=world.n_sheep,
        n_shepherds=int(first.team_size),
        goal_radius=float(first.goal_radius),
        frame_id=WORLD_FRAME,
        mode='lockstep',
        world=world.to_dict(),
    )
