#!/usr/bin/env python3
"""
What a console and a page hold after an hour in which other pages come and go.

One stack runs: flock_sim in real time, a lidar, a controller that stands still, and a console.
One page is open in Chromium all the time. Beside it websockets come and go, killed at the end:
some read, some never read, some send 2 MB of garbage. Nodes, listeners and heap of the page are
those after a collection of garbage.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import tempfile
import time
from typing import Any

from console import address_port, cpu, pages
from console_page import browser
from shepherd_ros.bringup import Process
from shepherd_ros.cli.processes import isolate, running
from timing import table

VISITS = (('read',), ('read', 'idle'), ('read', 'garbage'), ('idle', 'garbage'))


def held_by_console(pid: int) -> dict[str, Any]:
    """Return memory [MB], threads and open files of a process."""
    status = Path(f'/proc/{pid}/status').read_text(encoding='utf-8')
    fields = dict(line.split(':', 1) for line in status.splitlines() if ':' in line)
    return {
        'console [MB]': int(fields['VmRSS'].split()[0]) / 1024,
        'threads': int(fields['Threads']),
        'open files': sum(1 for _ in Path(f'/proc/{pid}/fd').iterdir()),
    }


def held_by_page(driver: Any) -> dict[str, Any]:
    """Return heap [MB], nodes and listeners of a page, and the frames that it has drawn."""
    driver.execute_cdp_cmd('HeapProfiler.collectGarbage', {})
    metrics = driver.execute_cdp_cmd('Performance.getMetrics', {})['metrics']
    value = {m['name']: m['value'] for m in metrics}
    return {
        'page [MB]': value['JSHeapUsedSize'] / 2**20,
        'nodes': int(value['Nodes']),
        'listeners': int(value['JSEventListeners']),
        'frames': driver.execute_script('return LIVE.frames'),
    }


def soaked(
    sheep: int, rate: float, minutes: float, visit: float, out: Path
) -> list[dict[str, Any]]:
    """Return a row for each minute; each is written to a file as it comes."""
    world = {'n_sheep': sheep, 'rate': rate, 'mode': 'realtime', 'episode_steps': 600}
    stack = [
        Process('flock_sim', 'flock_sim', world),
        Process('lidar', 'lidar', {'shepherd_ids': [0]}),
        Process('idle', 'idle'),
        Process('console', 'console', {'port': 0}),
    ]
    rows: list[dict[str, Any]] = []
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        running(Path(folder)) as processes,
    ):
        processes.start(stack)
        port, pid = address_port(processes), processes.started['console'].pid
        driver = browser(Path(folder) / 'profile')
        try:
            driver.get(f'http://127.0.0.1:{port}/')
            driver.execute_cdp_cmd('Performance.enable', {})
            begun, used, visits = time.monotonic(), cpu(pid), 0
            while (passed := time.monotonic() - begun) < 60 * minutes:
                with pages(port, VISITS[visits % len(VISITS)]):
                    time.sleep(visit)
                visits += 1
                if passed >= 60 * len(rows):
                    busy = 100 * (cpu(pid) - used) / max(passed, 1.0)
                    row = {
                        'minute': len(rows),
                        'visits': visits,
                        'console [% of a core]': busy,
                    }
                    rows.append(row | held_by_console(pid) | held_by_page(driver))
                    out.write_text(json.dumps(rows, indent=1) + '\n', encoding='utf-8')
                processes.check()
        finally:
            driver.quit()
    return rows


def main() -> int:
    """Measure, write rows as they come, and print every tenth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--sheep', type=int, default=100)
    parser.add_argument('--rate', type=float, default=10.0, help='steps of the world per second')
    parser.add_argument('--minutes', type=float, default=60.0)
    parser.add_argument('--visit', type=float, default=2.0, help='seconds that other pages stay')
    parser.add_argument('--out', type=Path, default=Path('console_soak.json'))
    options = parser.parse_args()
    isolate(os.environ)
    rows = soaked(options.sheep, options.rate, options.minutes, options.visit, options.out)
    table(f'{options.minutes:g} minutes with pages that come and go', rows[::10])
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
