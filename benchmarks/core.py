#!/usr/bin/env python3
"""World steps per second of the core, split into flock, lidar and controller."""

import argparse
from collections.abc import Callable
import json
from pathlib import Path
import time
from typing import Any

from shepherd_ros.controllers import make_controller
from shepherd_ros.sim import compiled
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.flocking import model_of
from shepherd_ros.sim.lidar import scan
from shepherd_ros.sim.rollout import EnvConfig
import torch


def rate(work: Callable[[], object], worlds: int, seconds: float) -> float:
    """Return worlds per second of wall time: the best of three runs, after a warm-up."""
    work()
    wait = torch.cuda.synchronize if torch.cuda.is_available() else lambda: None
    wait()
    best = 0.0
    for _ in range(3):
        count, start = 0, time.perf_counter()
        while time.perf_counter() - start < seconds / 3:
            work()
            count += 1
        wait()
        best = max(best, count * worlds / (time.perf_counter() - start))
    return best


def measure(worlds: int, seconds: float, device: str) -> dict[str, float]:
    """Return the rates of each part for a batch, with all sheep fleeing from three shepherds."""
    config = EnvConfig()
    env = ShepherdEnv(config, worlds, device=device)
    env.reset(0)
    controllers = {name: make_controller(name, config.world) for name in ('strombom', 'pierson')}
    memories = {name: c.begin(env.perceived) for name, c in controllers.items()}
    command, _ = controllers['strombom'].act(env.perceived, memories['strombom'])
    for _ in range(10):  # a state from the middle of an episode
        env.step(command)
    state, flock = env.state, config.world.flock
    law = model_of(flock).step
    return {
        'flock': rate(lambda: law(state, flock, config.world.dt), worlds, seconds),
        'lidar': rate(lambda: scan(state, config.lidar), worlds, seconds),
        **{
            name: rate(lambda n=name: controllers[n].act(state, memories[n]), worlds, seconds)
            for name in controllers
        },
        'environment': rate(lambda: env.step(command), worlds, seconds),
    }


def main() -> None:
    """Measure plain and compiled forms; print a table and write JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=1.5, help='per number')
    parser.add_argument('--threads', type=int, default=1)
    parser.add_argument('--worlds', type=int, nargs='+', default=[1, 64, 512])
    parser.add_argument('--device', default='cpu', help='cpu, or cuda (compiled by torch)')
    parser.add_argument('--json', default='')
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    rows: list[dict[str, Any]] = []
    for form in ('compiled', 'plain'):
        compiled.HAS_NUMBA = form == 'compiled'
        rows += [
            {'form': form, 'worlds': worlds, **measure(worlds, options.seconds, options.device)}
            for worlds in options.worlds
        ]
    names = list(rows[0])[2:]
    print('100 sheep, 3 shepherds, lidar of 3 x 3 x 512 rays; world steps per second')
    print('| form | worlds | ' + ' | '.join(names) + ' |')
    print('|---|--:|' + '--:|' * len(names))
    for row in rows:
        values = ' | '.join(f'{row[name]:,.0f}' for name in names)
        print(f'| {row["form"]} | {row["worlds"]} | {values} |')
    if options.json:
        Path(options.json).write_text(json.dumps(rows, indent=1), encoding='utf-8')


if __name__ == '__main__':
    main()
