#!/usr/bin/env python3
"""Start-up time and memory: of each node as a process, and of one more world in the core."""

import argparse
import json
import os
from pathlib import Path
import resource
import tempfile
import time

from shepherd_ros.bringup import herding_stack, Process
from shepherd_ros.cli.processes import isolate, running
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.rollout import EnvConfig
import torch

MANY = 512  # worlds


def resident(pid: int) -> float:
    """Return the memory of a process that is its own and in use [MB]."""
    text = Path(f'/proc/{pid}/smaps_rollup').read_text(encoding='utf-8')
    return int(text.split('Pss:')[1].split()[0]) / 1000


def node(process: Process) -> tuple[float, float]:
    """Return seconds until a node is in the graph, and its memory a second later [MB]."""
    import rclpy

    rclpy.init()
    probe = rclpy.create_node('probe')
    try:
        with tempfile.TemporaryDirectory() as folder, running(Path(folder)) as started:
            begun = time.monotonic()
            started.start([process])
            while process.name not in probe.get_node_names():
                time.sleep(0.01)
                started.check()
            took = time.monotonic() - begun
            time.sleep(1.0)
            return took, resident(started.started[process.name].pid)
    finally:
        rclpy.shutdown()


def world() -> float:
    """Return what one more world takes at its greatest [kB]: state, scans, frames, temporaries."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    env = ShepherdEnv(EnvConfig(), MANY)
    env.reset(0)
    for _ in range(3):
        env.step(torch.zeros(MANY, 3, 2))
    return (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / MANY


def main() -> None:
    """Measure all; print a table and write JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--json', default='')
    options = parser.parse_args()
    isolate(os.environ)
    torch.set_num_threads(1)
    stack = {p.executable: p for name in ('strombom', 'policy') for p in herding_stack(name)}
    rows = {name: node(process) for name, process in stack.items()}
    each = world()
    print('| node | start [s] | memory [MB] |\n|---|--:|--:|')
    for name, (took, memory) in rows.items():
        print(f'| {name} | {took:.2f} | {memory:.0f} |')
    print(f'\none more world of 100 sheep and 3 shepherds in a batch of {MANY}: {each:.0f} kB')
    if options.json:
        text = json.dumps({'nodes': rows, 'world_kB': each}, indent=1)
        Path(options.json).write_text(text, encoding='utf-8')


if __name__ == '__main__':
    main()
