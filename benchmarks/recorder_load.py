#!/usr/bin/env python3
"""A recorder under load: processes that publish scans, and what of them is in the bag."""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time
from typing import Any

import numpy as np
from shepherd_ros.cli.processes import executable
from shepherd_ros.rosbag2.bag import Bag
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.wire.encode import encode_scan

PUBLISHERS = 4
TOPIC = '/load_{k}/shepherd_0/scan/sheep'  # a scan of the contract, in a namespace of its own
SCAN = 'sensor_msgs/msg/LaserScan'
LOST = re.compile(r'lost: (\S+): (\d+)')
EARLIER = re.compile(r'first that was heard: (\S+): (\d+)')


def scan_row(k: int) -> bytes:
    """Return a scan of 512 rays with a number as its stamp [us]."""
    angles = np.linspace(0, 20, 512, dtype=np.float32)
    ranges = np.where(np.sin(angles + k) > 0, 5 + np.cos(angles * 3 + k), np.inf)
    return encode_scan(k * 1000, 'shepherd_0', ranges.astype(np.float32), 20.0, 0.5)


def number_of(raw: bytes) -> int:
    """Return the number of a scan_row."""
    sec, nanosec = np.frombuffer(raw, '<u4', 2, 4)
    return (int(sec) * 10**9 + int(nanosec)) // 1000


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
        [executable('recorder'), '-v', '-o', str(folder), *words],
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
            [sys.executable, __file__, TOPIC.format(k=k), str(count), str(rate)],
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


if __name__ == '__main__':
    publish(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]))
