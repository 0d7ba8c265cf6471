"""Episodes of the environment as bags, the same as those recorded from a running stack."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import shutil

import numpy as np
from shepherd_ros.bags.encode import (
    encode_clock,
    encode_command,
    encode_goal,
    encode_number,
    encode_poses,
    encode_scan,
    encode_text,
)
from shepherd_ros.bags.qos import Qos
from shepherd_ros.bags.writer import BagWriter
from shepherd_ros.controllers.base import Controller
from shepherd_ros.episode import Episode
from shepherd_ros.sim import transition
from shepherd_ros.sim.env import EnvConfig
from shepherd_ros.sim.lidar import CHANNELS, scan
from shepherd_ros.sim.metrics import count_step, METRICS, metrics, start_tally
from shepherd_ros.sim.perception import perceive
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.vectors import unit
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.topics import contract
import torch
from torch import Tensor

FRAME = 'map'


class EpisodeBag:
    """The bag of one episode: the topics of flock_sim, lidars, controller and metrics."""

    def __init__(self, folder: Path, episode: Episode, compression: str) -> None:
        """Open a bag in a folder that does not exist."""
        self.episode = episode
        self.writer = BagWriter(folder, compression=compression)
        self.now_ns = 0

    def put(self, topic: str, content: bytes, shepherd: int | None = None) -> None:
        """Write a message of a topic of the contract at the present time."""
        topics, profiles = contract()
        row = topics[topic]
        name = '/' + topic.format(h=shepherd).lstrip('/')
        self.writer.add_topic(name, row.type, [Qos.of_profile(profiles[row.profile])])
        self.writer.write(name, content, self.now_ns, self.now_ns)

    def step(
        self,
        stamp_ns: int,
        poses: dict[str, tuple[Tensor, Tensor]],
        ranges: np.ndarray,
        command: Tensor,
        metrics: dict[str, float],
        goal: Tensor,
        range_max: float,
    ) -> None:
        """Write a state, what was seen of it, what was commanded and how it counts."""
        first = self.now_ns == 0
        self.now_ns = stamp_ns
        if first:
            self.put('episode', encode_text(self.episode.to_json()))
            self.put('goal', encode_goal(stamp_ns, FRAME, float(goal[0]), float(goal[1])))
        self.put('/clock', encode_clock(stamp_ns))
        for name, (position, heading) in poses.items():
            self.put(name, encode_poses(stamp_ns, FRAME, position.numpy(), heading.numpy()))
        for h, channels in enumerate(ranges):
            for name, values in zip(CHANNELS, channels, strict=True):
                content = encode_scan(
                    stamp_ns, f'shepherd_{h}', values, range_max, self.episode.world.dt
                )
                self.put('shepherd_{h}/scan/' + name, content, h)
        for h, (x, y) in enumerate(command.tolist()):
            self.put('shepherd_{h}/cmd_vel', encode_command(stamp_ns, FRAME, x, y), h)
        for name, value in metrics.items():
            self.put(f'metrics/{name}', encode_number(value))


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

    A bag appears under its name when it is whole; on_step(worlds) is called after each step.
    """
    world, dt_ns = config.world, round(config.world.dt * 1e9)
    state = before = spawn(world, torch.arange(seeds.start, seeds.stop))
    tally = start_tally(state)
    unfinished = [out / f'.{episode_folder(out, seed).name}' for seed in seeds]
    for folder in unfinished:  # left by a run that was killed
        shutil.rmtree(folder, ignore_errors=True)
    bags = [
        EpisodeBag(folder, describe(world, state.world(k), seed), compression)
        for k, (folder, seed) in enumerate(zip(unfinished, seeds, strict=True))
    ]
    memory = controller.begin(perceive(state, config.noise_std))
    for step in range(world.episode_steps + 1):
        seen = perceive(state, config.noise_std)
        ranges = scan(seen, config.lidar)
        command, memory = controller.act(seen, memory)
        values = metrics(tally, state, world.episode_steps)
        moved = unit(state.shepherds - before.shepherds)
        for k, bag in enumerate(bags):
            team = bag.episode.n_shepherds
            bag.step(
                (step + 1) * dt_ns,
                {
                    'shepherds/poses': (state.shepherds[k, :team], moved[k, :team]),
                    'flock/poses': (state.sheep[k], state.heading[k]),
                },
                ranges[k, :team].numpy(),
                command[k, :team],
                {name: float(values[name][k]) for name in METRICS},
                state.goal[k],
                config.lidar.range_max,
            )
        if step < world.episode_steps:
            before, state = state, transition.step(state, command, world)
            tally = count_step(tally, before, state)
        on_step(len(bags))
    for bag, folder, seed in zip(bags, unfinished, seeds, strict=True):
        bag.writer.close()
        folder.rename(episode_folder(out, seed))


def describe(world: WorldConfig, start: WorldState, seed: int) -> Episode:
    """Return the description that flock_sim gives of an episode that it begins with."""
    return Episode(
        number=0,
        seed=seed,
        start_ns=round(world.dt * 1e9),
        n_sheep=world.n_sheep,
        n_shepherds=int(start.team_size),
        goal_radius=float(start.goal_radius),
        frame_id=FRAME,
        mode='lockstep',
        world=world,
    )
