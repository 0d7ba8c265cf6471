#!/usr/bin/env python3
"""Cost of a step against the size of flock and team: a table, JSON and a picture (log scales)."""

import argparse
from dataclasses import replace
import json
import math
from pathlib import Path
import time
from typing import Any

import matplotlib as mpl
from matplotlib import pyplot as plt
from shepherd_ros.controllers import make_controller
from shepherd_ros.sim.flocking import model_of
from shepherd_ros.sim.lidar import LidarConfig, scan
from shepherd_ros.sim.presets import world_preset
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.world import WorldConfig
import torch

ROOM = {'strombom': 0.33, 'reynolds': 1.5}  # [m2] of a sheep in a flock that is driven
PARTS = ('flock', 'lidar', 'strombom', 'pierson')


def driven(config: WorldConfig, flock: str) -> WorldState:
    """Return a world with an even flock of the usual density, shepherds all round it."""
    n, m = config.n_sheep, config.n_shepherds
    radius = math.sqrt(n * ROOM[flock] / math.pi)
    draw = torch.Generator().manual_seed(0)

    def ring(count: int, distance: torch.Tensor) -> torch.Tensor:
        angle = torch.rand(1, count, generator=draw) * 2 * math.pi
        return distance[..., None] * torch.stack([angle.cos(), angle.sin()], dim=-1)

    sheep = ring(n, radius * torch.rand(1, n, generator=draw).sqrt())
    shepherds = ring(m, torch.full((1, m), radius + 3.0))
    return replace(spawn(config, torch.tensor([0])), sheep=sheep, shepherds=shepherds)


def milliseconds(work: Any, seconds: float) -> float:
    """Return CPU time of one call [ms], the best of three runs."""
    work()
    best = math.inf
    for _ in range(3):
        count, begun = 0, time.process_time()
        while time.process_time() - begun < seconds / 3:
            work()
            count += 1
        best = min(best, 1e3 * (time.process_time() - begun) / count)
    return best


def measure(flock: str, n: int, m: int, seconds: float) -> dict[str, Any]:
    """Return the time of each part for one world [ms]."""
    config = replace(world_preset('default', flock), n_sheep=n, n_shepherds=m)
    state, lidar = driven(config, flock), LidarConfig()
    law = model_of(config.flock).step
    row: dict[str, Any] = {'flock_model': flock, 'sheep': n, 'shepherds': m}
    row['flock'] = milliseconds(lambda: law(state, config.flock, config.dt), seconds)
    row['lidar'] = milliseconds(lambda: scan(state, lidar), seconds)
    for name in ('strombom', 'pierson'):
        controller = make_controller(name, config)
        memory = controller.begin(state)
        row[name] = milliseconds(lambda c=controller, k=memory: c.act(state, k), seconds)
    return row


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw time over sheep and over shepherds."""
    mpl.use('Agg')
    figure, axes = plt.subplots(1, 3, figsize=(12, 4), constrained_layout=True, sharey=True)
    views = (
        ('strombom', 'sheep', 3, 'Strömbom flock, 3 shepherds'),
        ('reynolds', 'sheep', 3, 'Reynolds flock, 3 shepherds'),
        ('strombom', 'shepherds', 100, 'Strömbom flock, 100 sheep'),
    )
    other = {'sheep': 'shepherds', 'shepherds': 'sheep'}
    for ax, (flock, over, fixed, title) in zip(axes, views, strict=True):
        mine = [r for r in rows if r['flock_model'] == flock and r[other[over]] == fixed]
        mine.sort(key=lambda r: r[over])
        for part, mark in zip(PARTS, 'osv^', strict=True):
            ax.plot([r[over] for r in mine], [r[part] for r in mine], mark + '-', label=part)
        ax.set(xscale='log', yscale='log', xlabel=over, title=title)
        ax.grid(alpha=0.3)
    axes[0].set_ylabel('time of a step of one world [ms]')
    axes[0].legend(frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Measure all; print a table, write JSON and a picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=0.6, help='per number')
    parser.add_argument(
        '--sheep', type=int, nargs='+', default=[10, 30, 100, 300, 1000, 3000, 10000]
    )
    parser.add_argument('--shepherds', type=int, nargs='+', default=[1, 3, 10, 25, 50])
    parser.add_argument('--json', default='')
    parser.add_argument('--picture', type=Path, default=Path('out/growth.png'))
    options = parser.parse_args()
    torch.set_num_threads(1)
    cases = [(flock, n, 3) for flock in ROOM for n in options.sheep]
    cases += [('strombom', 100, m) for m in options.shepherds]
    rows = [measure(*case, options.seconds) for case in dict.fromkeys(cases)]
    print('| flock | sheep | shepherds | ' + ' | '.join(f'{p} [ms]' for p in PARTS) + ' |')
    print('|---|--:|--:|' + '--:|' * len(PARTS))
    for row in rows:
        cells = ' | '.join(f'{row[part]:.3g}' for part in PARTS)
        print(f'| {row["flock_model"]} | {row["sheep"]} | {row["shepherds"]} | {cells} |')
    draw(rows, options.picture)
    print(options.picture)
    if options.json:
        Path(options.json).write_text(json.dumps(rows, indent=1), encoding='utf-8')


if __name__ == '__main__':
    main()
