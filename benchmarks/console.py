#!/usr/bin/env python3
"""
What a console and its pages cost the graph: cycles per second with them, beside those without.

One stack runs: flock_sim in lockstep with a controller that stands still, and a console. In each
round every kind of page takes its turn, and its cycle rate is divided by that of the same round
without a page. Pages are processes of their own; each acknowledges its frames as it gets them.
"""

import argparse
import asyncio
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
import json
import multiprocessing as mp
from multiprocessing.sharedctypes import Synchronized
import os
from pathlib import Path
import re
from statistics import median
import tempfile
import time
from typing import Any

from shepherd_ros.bringup import Process
from shepherd_ros.cli.processes import isolate, Running, running
from timing import table

TICKS = os.sysconf('SC_CLK_TCK')
KINDS = {  # pages that are open, by what they do
    'no page': (),
    'one page': ('read',),
    'two pages': ('read', 'read'),
    'one reads, one does not': ('read', 'idle'),
    'one reads, others are killed': ('read', 'killed'),
    'one reads, others send 2 MB': ('read', 'garbage'),
}


async def _page(port: int, kind: str, frames: 'Synchronized[int]') -> None:
    """Be a page until it is closed."""
    from tornado.websocket import websocket_connect

    page = await websocket_connect(f'ws://127.0.0.1:{port}/ws')
    if kind == 'garbage':
        await page.write_message(os.urandom(2_000_000), binary=True)
    await page.write_message(json.dumps({'do': 'watch', 'shepherd': 0}))
    if kind == 'idle':
        await asyncio.sleep(3600)
    while (message := await page.read_message()) is not None:
        if isinstance(message, bytes):
            number = int.from_bytes(message[4:8], 'little')
            await page.write_message(json.dumps({'do': 'ack', 'frame': number}))
            frames.value += 1


def _run_page(port: int, kind: str, frames: 'Synchronized[int]') -> None:
    """Be a page; one that is closed comes again."""
    from tornado.websocket import WebSocketClosedError

    while True:
        with suppress(OSError, WebSocketClosedError):
            asyncio.run(_page(port, kind, frames))
        time.sleep(0.1)


@contextmanager
def pages(port: int, kinds: tuple[str, ...]) -> Iterator['Synchronized[int]']:
    """Open pages, and lend the number of frames that they get."""
    frames = mp.Value('q', 0)
    opened = [
        mp.Process(target=_run_page, args=(port, kind, frames), daemon=True)
        for kind in kinds
        if kind != 'killed'
    ]
    for process in opened:
        process.start()
    try:
        yield frames
    finally:
        for process in opened:
            process.kill()
            process.join()


def cpu(pid: int) -> float:
    """Return the processor time of a process so far [s]."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def address_port(processes: Running) -> int:
    """Return the port of the console once it listens."""
    while True:
        processes.check()
        log = (processes.logs / 'console.log').read_text(errors='replace')
        if found := re.search(r'open http://[\d.]+:(\d+)/', log):
            return int(found[1])
        time.sleep(0.1)


class Clock:
    """The simulated clock of the graph, read without a callback."""

    def __init__(self) -> None:
        """Subscribe."""
        import rclpy  # which reads the environment when it is imported
        from shepherd_ros.ros.polling import PolledGroup, PolledTopic
        from shepherd_ros.wire.topics import CLOCK

        if not rclpy.ok():
            rclpy.init()
        self.topic = PolledTopic(rclpy.create_node('probe'), PolledGroup(), CLOCK)

    def steps(self, dt: float = 0.5) -> float:
        """Return how many steps the world has made."""
        from shepherd_ros.wire.decode import decode_clock

        while not (messages := self.topic.take()):
            time.sleep(0.001)
        return float(decode_clock(messages[-1])) * 1e-9 / dt


def measured(sheep: int, rate: float, seconds: float, rounds: int) -> list[dict[str, Any]]:
    """Return a row for each kind of page."""
    world = {'n_sheep': sheep, 'episode_steps': 10_000_000, 'rate': rate}
    stack = [
        Process('flock_sim', 'flock_sim', world),
        Process('lidar', 'lidar', {'shepherd_ids': [0]}),
        Process('idle', 'idle'),
        Process('console', 'console', {'port': 0}),
    ]
    cycles: defaultdict[str, list[float]] = defaultdict(list)
    busy: defaultdict[str, list[float]] = defaultdict(list)
    shown: defaultdict[str, list[float]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder, running(Path(folder)) as processes:
        processes.start(stack)
        port, clock = address_port(processes), Clock()
        pid = processes.started['console'].pid
        clock.steps()
        time.sleep(2.0)
        for _ in range(rounds):
            for name, kinds in KINDS.items():
                with pages(port, kinds) as frames:
                    time.sleep(1.0)
                    before = time.monotonic(), clock.steps(), cpu(pid), frames.value
                    for _ in range(4):
                        time.sleep(seconds / 4)
                        if 'killed' in kinds:
                            with pages(port, ('read',)):
                                time.sleep(0.1)
                    after = time.monotonic(), clock.steps(), cpu(pid), frames.value
                passed, steps, used, got = (b - a for a, b in zip(before, after, strict=True))
                cycles[name].append(steps / passed)
                busy[name].append(100 * used / passed)
                shown[name].append(got / passed / max(kinds.count('read'), 1))
        processes.check()
    return [
        {
            'pages': name,
            'cycles/s': median(cycles[name]),
            'ratio': median(a / b for a, b in zip(cycles[name], cycles['no page'], strict=True)),
            'frames/s of a page': median(shown[name]),
            'console [% of a core]': median(busy[name]),
        }
        for name in KINDS
    ]


def main() -> int:
    """Measure, print tables and write them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--sheep', type=int, nargs='+', default=[100, 1000])
    parser.add_argument('--rate', type=float, default=50.0, help='cycles per second; 0: any')
    parser.add_argument('--seconds', type=float, default=4.0, help='of each turn')
    parser.add_argument('--rounds', type=int, default=3)
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    isolate(os.environ)
    found = {}
    for sheep in options.sheep:
        found[str(sheep)] = measured(sheep, options.rate, options.seconds, options.rounds)
        table(f'{sheep} sheep, at most {options.rate:g} cycles per second', found[str(sheep)])
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + '\n', encoding='utf-8')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
