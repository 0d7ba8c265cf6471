#!/usr/bin/env python3
"""
Speed and losses of recorder, writer and player, with processes of their own over real DDS.

Parts: writer, sizes, rate, stack, limit, disk, player. Every run of the recorder is checked: what
was sent is in the bag or is told as lost.
"""

import argparse
from collections.abc import Callable, Sequence
import json
import os
from pathlib import Path
import re
import subprocess
import tempfile
import time
from typing import Any

from recorder_load import flood, PUBLISHERS, record, run, SCAN, scan_row
from shepherd_ros.bringup import herding_stack
from shepherd_ros.cli.processes import executable, isolate, running
from shepherd_ros.recordings.recording_writer import RecordingWriter
from shepherd_ros.rosbag2.reader import open_bag

KINDS = ('none', 'lz4', 'zstd')
LATE = re.compile(r'late by ([\d.]+) ms \(p50\), ([\d.]+) ms \(p99\)')


def episode(out: Path, kind: str) -> Path:
    """Record the default episode without ROS; return its bag."""
    from shepherd_ros.controllers import make_controller
    from shepherd_ros.recordings.record import episode_folder, record_episodes
    from shepherd_ros.sim.rollout import EnvConfig

    config = EnvConfig()
    record_episodes(config, make_controller('strombom', config.world), range(1), out, kind)
    return episode_folder(out, 0)


def writer(root: Path) -> list[dict[str, Any]]:
    """Return how many scans per second the writer alone takes."""
    bag = open_bag(episode(root / 'source', 'none'))
    scans = [m for m in bag.messages() if m.type == SCAN]
    rows = []
    for kind in KINDS:
        begun = time.perf_counter()
        with RecordingWriter(root / f'writer_{kind}', compression=kind) as out:
            for topic in {m.topic for m in scans}:
                out.add_topic(topic, SCAN)
            for _ in range(5):
                for m in scans:
                    out.write(m.topic, m.data, m.log_ns, m.publish_ns)
        seconds = time.perf_counter() - begun
        rows.append({'compression': kind, 'scans/s': round(5 * len(scans) / seconds)})
        print(rows[-1], flush=True)
    return rows


def sizes(root: Path) -> list[dict[str, Any]]:
    """Return the bytes of a default episode: 100 sheep, 3 shepherds, 1000 steps."""
    rows = []
    for kind in KINDS:
        folder = episode(root / f'size_{kind}', kind)
        size = sum(path.stat().st_size for path in folder.iterdir())
        count = open_bag(folder).count
        rows.append({'compression': kind, 'messages': count, 'bytes': size})
        print(rows[-1], flush=True)
    return rows


def rate(root: Path, seconds: float = 5.0) -> list[dict[str, Any]]:
    """Return what is recorded at several rates, nothing else running."""
    rows = []
    for wanted in (1000, 2000, 4000, 8000, 12000, 16000):
        each = wanted / PUBLISHERS
        count = round(each * seconds)
        folder = root / f'rate_{wanted}'
        rows.append(run(folder, count, wanted, lambda c=count, e=each: flood(c, e), 'alone'))
    return rows


def stack(root: Path, count: int = 15_000) -> list[dict[str, Any]]:
    """
    Return what is recorded at 4000 per second while flock_sim, lidars and strombom run.

    With the discovery range LOCALHOST messages go through shared memory, with SUBNET over UDP.
    """
    rows = []
    for mode, more, ways in (
        ('realtime', {'rate': 10.0}, 'LOCALHOST'),
        ('lockstep', {}, 'LOCALHOST'),
        ('realtime', {'rate': 10.0}, 'SUBNET'),
        ('lockstep', {}, 'SUBNET'),
    ):
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = ways

        def load(mode: str = mode, more: dict[str, Any] = more) -> float:
            processes = [p for p in herding_stack(mode=mode, **more) if p.executable != 'metrics']
            with running(root / 'logs') as others:
                others.start(processes)
                time.sleep(4.0)
                reached = flood(count, 4000 / PUBLISHERS)
                others.check()
                return reached

        way = {'LOCALHOST': 'shared memory', 'SUBNET': 'UDP'}[ways]
        what = f'with the stack, {mode}, {way}'
        rows.append(run(root / f'stack_{mode}_{ways}', count, 4000, load, what))
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    return rows


def limit(root: Path, count: int = 20_000) -> list[dict[str, Any]]:
    """Return what is told of a run that nobody can record: the recorder stands still for it."""
    folder = root / 'limit'
    return [run(folder, count, 0, lambda: flood(count, 0), 'as fast as it goes')]


def player(root: Path) -> list[dict[str, Any]]:
    """Return how late the player is with 1000 scans per second, at rates 1 and 4."""
    bag = root / 'play'
    with RecordingWriter(bag) as out:
        out.add_topic('/scan', SCAN)
        for k in range(10_000):
            out.write('/scan', scan_row(k), k * 1_000_000, k * 1_000_000)
    rows = []
    for pace in (1.0, 4.0):
        folder = root / f'played_{pace}'

        def load(pace: float = pace) -> str:
            words = [executable('player'), str(bag), '--rate', str(pace), '--wait', '10']
            return subprocess.run(words, check=True, capture_output=True, text=True).stdout

        said, code, _, _ = record(folder, load, '--topics', '/scan')
        half, most = map(float, LATE.findall(said)[0])
        rows.append({
            'messages/s': 1000 * pace, 'late p50 [ms]': half, 'late p99 [ms]': most,
            'recorded again': open_bag(folder).count, 'exit code of recorder': code,
        })  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def disk(root: Path) -> list[dict[str, Any]]:
    """Return what a recorder says and leaves when a disk of 4 MiB is full; needs root."""
    place = root / 'small'
    place.mkdir()
    mount = ['mount', '-t', 'tmpfs', '-o', 'size=4m', 'tmpfs', str(place)]
    if subprocess.run(mount, check=False, capture_output=True).returncode:
        print('disk: left out, as mount is not allowed here')
        return []
    try:
        folder = place / 'bag'
        _, code, output, _ = record(folder, lambda: flood(2000, 250))
        failed = [line for line in output.splitlines() if line.startswith('failed:')]
        size = sum(path.stat().st_size for path in folder.iterdir())
        rows = [
            {'exit code': code, 'in the bag': open_bag(folder).count, 'bytes': size,
             'said': failed[0].replace(str(folder), '<bag>')},
        ]  # fmt: skip
        print(rows[0], flush=True)
        return rows
    finally:
        subprocess.run(['umount', str(place)], check=True)


PARTS: dict[str, Callable[[Path], list[dict[str, Any]]]] = {
    'writer': writer, 'sizes': sizes, 'rate': rate, 'stack': stack, 'limit': limit, 'disk': disk,
    'player': player,
}  # fmt: skip


def table(rows: Sequence[dict[str, Any]]) -> None:
    """Print rows as Markdown."""
    print('| ' + ' | '.join(rows[0]) + ' |')
    print('|' + '--:|' * len(rows[0]))
    for row in rows:
        print(
            '| '
            + ' | '.join(f'{v:,}' if isinstance(v, int) else str(v) for v in row.values())
            + ' |'
        )


def main() -> None:
    """Measure the parts that are asked for, print tables, write JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('parts', nargs='*', default=list(PARTS), help=', '.join(PARTS))
    parser.add_argument('--json', default='')
    options = parser.parse_args()
    isolate(os.environ)
    results = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in options.parts:
            results[name] = PARTS[name](Path(folder))
    for name, rows in results.items():
        if rows:
            print(f'\n{name}\n')
            table(rows)
    if options.json:
        Path(options.json).write_text(json.dumps(results, indent=1), encoding='utf-8')


if __name__ == '__main__':
    main()
