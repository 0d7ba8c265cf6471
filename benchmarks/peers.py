#!/usr/bin/env python3
"""
Shepherd observations per second beside VMAS (Bettini et al. 2022), in one run.

Both have three robots with a lidar of 512 rays for each of three types, and 100 round animals
are seen; ours computes a flock, there they stand. A step moves the world and reads all lidars.
"""

import argparse
import json
from pathlib import Path
import time

from shepherd_ros.controllers import make_controller
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.rollout import EnvConfig
import torch
from vmas import make_env
from vmas.simulator.core import Agent, Landmark, Sphere, World
from vmas.simulator.scenario import BaseScenario
from vmas.simulator.sensors import Lidar

SHEPHERDS, SHEEP, RAYS, RANGE = 3, 100, 512, 75.0
KINDS = ('sheep', 'shepherd', 'goal')


class Herd(BaseScenario):
    """Three robots, a goal and animals; VMAS casts rays only to what can be bumped into."""

    def make_world(self, batch_dim: int, device: torch.device, **kwargs: object) -> World:
        """Return the world."""
        world = World(batch_dim, device, dt=0.5)
        for h in range(SHEPHERDS):
            sensors = [
                Lidar(
                    world,
                    n_rays=RAYS,
                    max_range=RANGE,
                    entity_filter=lambda entity, kind=kind: entity.name.startswith(kind),
                )
                for kind in KINDS
            ]
            shape = Sphere(0.5)
            world.add_agent(Agent(f'shepherd_{h}', shape=shape, sensors=sensors))
        for k in range(SHEEP):
            shape = Sphere(0.5)
            world.add_landmark(Landmark(f'sheep_{k}', shape=shape))
        world.add_landmark(Landmark('goal', shape=Sphere(4.0)))
        return world

    def reset_world_at(self, env_index: int | None = None) -> None:
        """Put everything somewhere."""
        count = self.world.batch_dim if env_index is None else 1
        for entity in self.world.entities:
            entity.set_pos(20 * torch.randn(count, 2), batch_index=env_index)

    def observation(self, agent: Agent) -> torch.Tensor:
        """Return what the three lidars read, (B, 3 * 512)."""
        return torch.cat([sensor.measure() for sensor in agent.sensors], dim=-1)

    def reward(self, agent: Agent) -> torch.Tensor:
        """Return nothing of interest."""
        return torch.zeros(self.world.batch_dim)


def theirs(worlds: int, seconds: float) -> float:
    """Return observations per second of VMAS."""
    env = make_env(Herd(), num_envs=worlds, device='cpu', continuous_actions=True, seed=0)
    env.reset()
    push = [torch.zeros(worlds, 2) for _ in range(SHEPHERDS)]
    steps, begun = 0, time.perf_counter()
    while steps < 2 or time.perf_counter() - begun < seconds:
        env.step(push)
        steps += 1
    return SHEPHERDS * worlds * steps / (time.perf_counter() - begun)


def ours(worlds: int, seconds: float) -> float:
    """Return observations per second of ShepherdEnv: flock, lidar, frames, reward, metrics."""
    config = EnvConfig()
    env = ShepherdEnv(config, worlds)
    env.reset(0)
    law = make_controller('strombom', config.world)
    command, _ = law.act(env.perceived, law.begin(env.perceived))
    for _ in range(10):  # all sheep flee
        env.step(command)
    steps, begun = 0, time.perf_counter()
    while steps < 2 or time.perf_counter() - begun < seconds:
        env.step(command)
        steps += 1
    return SHEPHERDS * worlds * steps / (time.perf_counter() - begun)


def main() -> None:
    """Measure in turns; print a table and write JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--worlds', type=int, nargs='+', default=[32, 256])
    parser.add_argument('--seconds', type=float, default=10.0, help='per number')
    parser.add_argument('--rounds', type=int, default=2)
    parser.add_argument('--threads', type=int, default=1)
    parser.add_argument('--json', default='')
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    rows = []
    for worlds in options.worlds:
        for _ in range(options.rounds):
            one, other = ours(worlds, options.seconds), theirs(worlds, options.seconds)
            rows.append({'worlds': worlds, 'ours': one, 'vmas': other, 'ratio': one / other})
    print('shepherd observations per second: 3 shepherds, 100 sheep, 3 x 512 rays each')
    print('| worlds | ours | VMAS | ratio |\n|--:|--:|--:|--:|')
    for row in rows:
        print('| {worlds} | {ours:,.0f} | {vmas:,.1f} | {ratio:,.0f} |'.format(**row))
    if options.json:
        Path(options.json).write_text(json.dumps(rows, indent=1), encoding='utf-8')


if __name__ == '__main__':
    main()
