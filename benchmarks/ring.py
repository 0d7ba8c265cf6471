#!/usr/bin/env python3
"""
Cycles per second of the lockstepped ring, beside its parts measured in the same run.

The real ring is flock_sim -> 3 lidars and the controller -> flock_sim with 100 sheep and 3
shepherds, where a step waits for all scans and all commands. Its parts are the bare ring (the same
hops with empty callbacks) and the core (one step, three scans and one control as function calls).
With --clock cpu, seconds are those of the one thread that works, which other load on the machine
disturbs less; it measures what runs in one process only.
"""

import argparse
from contextlib import ExitStack
import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import tempfile
import time

from shepherd_ros.bringup import herding_stack, Process
from shepherd_ros.cli.processes import isolate, running
from shepherd_ros.controllers import make_controller
from shepherd_ros.sim.lidar import LidarConfig, scan
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.transition import step
from shepherd_ros.sim.world import WorldConfig
import torch

HERE = Path(__file__).parent
LOG_TIME = re.compile(r'\[(\d+\.\d+)\] \[flock_sim\]: episode (\d+)')


def core(controller: str, seconds: float, clock: str) -> float:
    """Return cycles per second of plain function calls: control, step, a scan per shepherd."""
    world = WorldConfig()
    law, lidar = make_controller(controller, world), LidarConfig()
    state = spawn(world, torch.tensor(0))
    memory = law.begin(state)
    ids = [torch.tensor([h]) for h in range(3)]
    now = time.thread_time if clock == 'cpu' else time.monotonic
    cycles, begun, start = 0, 0.0, 0
    while not begun or now() - begun < seconds:
        command, memory = law.act(state, memory)
        state = step(state, command, world)
        for which in ids:
            scan(state, lidar, which)
        cycles += 1
        if cycles == 50:
            begun, start = now(), cycles
        if cycles % 1000 == 0:
            state = spawn(world, torch.tensor(cycles))
            memory = law.begin(state)
    return (cycles - start) / (now() - begun)


def bare(separate: bool, executor: str, scans: int, seconds: float, clock: str) -> float:
    """Return rounds per second of the bare ring."""
    words = [sys.executable, str(HERE / 'bare_ring.py')]
    options = ['--executor', executor, '--scans', str(scans), '--seconds', str(seconds)]
    options += ['--clock', clock]
    with ExitStack() as stack:
        if separate:
            for role in ('0', '1', '2', 'controller'):
                process = subprocess.Popen([*words, role, *options])
                stack.callback(process.wait)
                stack.callback(process.send_signal, signal.SIGKILL)
        first = 'sim' if separate else 'all'
        out = subprocess.run([*words, first, *options], check=True, stdout=subprocess.PIPE)
    return float(out.stdout)


def real(separate: bool, executor: str, controller: str, steps: int, clock: str) -> float:
    """Return cycles per second of the real nodes in their second episode."""
    if not separate:
        words = [sys.executable, str(HERE / 'composed_ring.py'), executor, controller]
        out = subprocess.run(
            [*words, str(steps), clock], check=True, capture_output=True, text=True
        )
        return float(re.findall(r'(\S+) cycles per second', out.stdout)[0])
    stack = [
        Process(p.executable, p.name, p.parameters | {'executor': executor})
        for p in herding_stack(controller, episode_steps=steps, episodes=2, wait_for_scans=True)
        if p.executable != 'metrics'
    ]
    with tempfile.TemporaryDirectory() as folder, running(Path(folder)) as processes:
        processes.start(stack)
        while not processes.ended('flock_sim'):
            processes.check()
            time.sleep(0.2)
        text = (Path(folder) / 'flock_sim.log').read_text(encoding='utf-8')
    begun = {int(number): float(at) for at, number in LOG_TIME.findall(text)}
    ended = float(re.findall(r'\[(\d+\.\d+)\] \[flock_sim\]: 2 episodes done', text)[0])
    return (steps + 1) / (ended - begun[1])


def main() -> None:
    """Measure everything, print a table, write JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=8.0, help='per number')
    parser.add_argument('--steps', type=int, default=1000, help='per episode of the real ring')
    parser.add_argument('--controller', default='strombom')
    parser.add_argument('--clock', default='wall', choices=('wall', 'cpu'))
    parser.add_argument('--json', default='')
    options = parser.parse_args()
    torch.set_num_threads(1)
    isolate(os.environ)
    rows = []
    for separate, executor in (
        (True, 'events'),
        (False, 'events'),
        (True, 'single'),
        (False, 'single'),
    ):
        if separate and options.clock == 'cpu':
            continue
        parts = core(options.controller, options.seconds, options.clock)
        bare_1 = bare(separate, executor, 1, options.seconds, options.clock)
        bare_3 = bare(separate, executor, 3, options.seconds, options.clock)
        ring = real(separate, executor, options.controller, options.steps, options.clock)
        rows.append({
            'layout': '5 processes' if separate else '1 process',
            'executor': executor,
            'load': os.getloadavg()[0],  # processes that wanted to run, in the last minute
            'ring': ring,
            'bare_ring': bare_1,
            'bare_ring_9_scans': bare_3,
            'core': parts,
            'cost_over_parts': (1 / ring) / (1 / bare_1 + 1 / parts),
            'cost_over_parts_9_scans': (1 / ring) / (1 / bare_3 + 1 / parts),
        })  # fmt: skip
        print(rows[-1], flush=True)
    names = list(rows[0])
    print('| ' + ' | '.join(names) + ' |')
    print('|' + '---|' * len(names))
    for row in rows:
        cells = (f'{v:.3g}' if isinstance(v, float) else str(v) for v in row.values())
        print('| ' + ' | '.join(cells) + ' |')
    if options.json:
        Path(options.json).write_text(json.dumps(rows, indent=1), encoding='utf-8')


if __name__ == '__main__':
    main()
