#!/usr/bin/env python3
"""
Speed and losses of recorder, writer and player, with processes of their own over real DDS.

Parts: writer, sizes, rate, stack, limit, disk, player. Every run of the recorder is checked: what
was sent is in the bag or is told as lost.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np
from shepherd_ros.bringup import herding_stack
from shepherd_ros.cli.processes import executable, isolate, running
from shepherd_ros.rosbag2.reader import Bag, open_bag
from shepherd_ros.rosbag2.writer import BagWriter
from shepherd_ros.wire.encode import encode_scan

KINDS = ('none', 'lz4', 'zstd')
PUBLISHERS = 4
TOPIC = '/load_{k}/shepherd_0/scan/sheep'  # a scan of the contract, in a namespace of its own
SCAN = 'sensor_msgs/msg/LaserScan'
LOST = re.compile(r'lost: (\S+): (\d+)')
EARLIER = re.compile(r'first that was heard: (\S+): (\d+)')
LATE = re.compile(r'late by ([\d.]+) ms \(p50\), ([\d.]+) ms \(p99\)')


def scan_row(k: int) -> bytes:
    """Return a scan of 512 rays with a number as its stamp [us]."""
    angles = np.linspace(0, 20, 512, dtype=np.float32)
    ranges = np.where(np.sin(angles + k) > 0, 5 + np.cos(angles * 3 + k), np.inf)
    return encode_scan(k * 1000, 'shepherd_0', ranges.astype(np.float32), 20.0, 0.5)


def number_of(raw: bytes) -> int:
    """Return the number of a scan_row."""
    sec, nanosec = np.frombuffer(raw, '<u4', 2, 4)
    return (int(sec) * 10**9 + int(nanosec)) // 1000


# ---- processes ----


def publish(topic: str, count: int, rate: float) -> None:
    """Publish scans with the quality of service of the contract; rate 0: as fast as it goes."""
    import rclpy
    from rclpy.duration import Duration
    from shepherd_ros.ros.node import message_type, quality

    rclpy.init()
    node = rclpy.create_node('load_' + topic.split('/')[1], enable_rosout=False)
    output = node.create_publisher(message_type(SCAN), topic, quality('shepherd_{h}/scan/sheep'))
    rows = [scan_row(k) for k in range(count)]
    while not output.get_subscription_count():
        time.sleep(0.02)
    print('ready', flush=True)
    sys.stdin.readline()
    begun = time.monotonic()
    for k, row in enumerate(rows):
        while rate and (ahead := begun + k / rate - time.monotonic()) > 0:
            time.sleep(ahead)
        output.publish(row)
    seconds = time.monotonic() - begun
    output.wait_for_all_acked(Duration(seconds=5.0))
    print(seconds, flush=True)
    sys.stdin.readline()  # be there until nobody needs a message again


@contextmanager
def recorder(folder: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    """Give a recorder that runs."""
    process = subprocess.Popen(
        [executable('recorder'), '-o', str(folder), *words],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def flood(count: int, rate: float) -> float:
    """Let all publishers send at the same time; return the rate that they reached [1/s]."""
    processes = [
        subprocess.Popen(
            [sys.executable, __file__, 'publish', TOPIC.format(k=k), str(count), str(rate)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )
        for k in range(PUBLISHERS)
    ]  # fmt: skip
    try:
        for process in processes:
            assert process.stdout is not None
            assert process.stdout.readline() == 'ready\n'
        for process in processes:
            assert process.stdin is not None
            process.stdin.write('go\n')
            process.stdin.flush()
        seconds = [float(process.stdout.readline()) for process in processes]  # type: ignore[union-attr]
        time.sleep(0.5)  # what is on its way
        return PUBLISHERS * count / max(seconds)
    finally:
        for process in processes:
            process.kill()
            process.wait()


def record(folder: Path, load: Callable[[], Any], *words: str) -> tuple[Any, int, str, float]:
    """Record while load() runs; return what it returns, exit code, output and CPU time [s]."""
    with recorder(folder, *words) as process:
        time.sleep(2.0)
        result = load()
        cpu = cpu_seconds(process.pid)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=120)
    return result, process.returncode, output, cpu


def cpu_seconds(pid: int) -> float:
    """Return the CPU time of a process so far [s]."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def loaded(bag: Bag, count: int) -> tuple[int, dict[str, int]]:
    """Return how many scans of the publishers are in a bag, and how many are not, by topic."""
    topics = {TOPIC.format(k=k): 0 for k in range(PUBLISHERS)}
    last = dict.fromkeys(topics, -1)
    for message in bag.messages(set(topics)):
        number = number_of(message.data)
        assert number > last[message.topic], f'{message.topic}: {number} out of order'
        last[message.topic] = number
        topics[message.topic] += 1
    return sum(topics.values()), {name: count - n for name, n in topics.items()}


def run(
    folder: Path, count: int, rate: float, load: Callable[[], float], what: str
) -> dict[str, Any]:
    """Record a load and compare what was sent, what is in the bag, and what was told."""
    reached, code, output, cpu = record(folder, load)
    told = Counter({topic: int(n) for topic, n in LOST.findall(output)})
    told.update({topic: int(n) for topic, n in EARLIER.findall(output)})
    kept, missing = loaded(open_bag(folder), count)
    silent = {topic: n - told[topic] for topic, n in missing.items()}
    row = {
        'run': what, 'wanted [1/s]': rate, 'reached [1/s]': round(reached),
        'sent': PUBLISHERS * count, 'in the bag': kept,
        'told as missing': sum(told[topic] for topic in missing),
        'missing and not told': sum(silent.values()), 'exit code': code,
        'all messages': open_bag(folder).count, 'recorder CPU [s]': round(cpu, 1),
    }  # fmt: skip
    print(row, flush=True)
    if code not in (0, 1):
        print(output)
    return row


# ---- parts ----


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
        with BagWriter(root / f'writer_{kind}', compression=kind) as out:
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
    with BagWriter(bag) as out:
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
    if sys.argv[1:2] == ['publish']:
        publish(sys.argv[2], int(sys.argv[3]), float(sys.argv[4]))
        return
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
