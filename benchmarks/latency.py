#!/usr/bin/env python3
"""
From scan to command: how long a policy node takes, beside its bare network.

The stack runs in real time with a process for each node. A latency is from the moment that the
last scan of a stamp was sent to that at which the last command of it was, by the clocks of the
senders. The bare network answers one batch of as many shepherds in the same Python.
"""

import argparse
from collections import defaultdict
import json
import os
from pathlib import Path
import struct
import tempfile
import time

from shepherd_ros.bringup import herding_stack
from shepherd_ros.cli.processes import isolate, running
from shepherd_ros.policy.checkpoint import load_policy
from shepherd_ros.sim.flocking.strombom_flock import StrombomFlock
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS
import torch


def bare(shepherds: int, seconds: float) -> list[float]:
    """Return times of the network's answers to one batch [ms]."""
    policy = load_policy(StrombomFlock.checkpoint)
    frames = torch.rand(shepherds, policy.config.observation.n_frames, 3, 512) * 7
    x = policy.arrange(frames, policy.first_ray(frames[:, -1]))
    times, end = [], time.perf_counter() + seconds
    with torch.no_grad():
        for _ in range(20):
            policy.actor(x)
        while time.perf_counter() < end:
            begun = time.perf_counter()
            policy.actor(x)
            times.append(1e3 * (time.perf_counter() - begun))
            time.sleep(0.02)  # as often as the node is asked
    return times


def stack(shepherds: int, rate: float, seconds: float) -> list[float]:
    """Return times from scans to commands of a running stack [ms]."""
    # rclpy reads the environment when it is imported
    from geometry_msgs.msg import TwistStamped
    import rclpy
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import LaserScan
    from shepherd_ros.ros.runtime import make_executor

    sent: defaultdict[tuple[int, int], int] = defaultdict(int)  # last scan of a stamp
    answered: defaultdict[tuple[int, int], int] = defaultdict(int)
    heard: defaultdict[tuple[int, int], int] = defaultdict(int)

    def note(table: dict[tuple[int, int], int], raw: bytes, info: dict[str, int]) -> None:
        stamp = struct.unpack_from('<iI', raw, 4)
        table[stamp] = max(table[stamp], info['source_timestamp'])
        heard[stamp] += 1

    rclpy.init()
    node = rclpy.create_node('probe')
    for h in range(shepherds):
        for topic, kind, table in (
            *((f'shepherd_{h}/scan/{channel}', LaserScan, sent) for channel in PAPER_CHANNELS),
            (f'shepherd_{h}/cmd_vel', TwistStamped, answered),
        ):
            node.create_subscription(
                kind,
                topic,
                lambda raw, info, table=table: note(table, raw, info),
                qos_profile_sensor_data,
                raw=True,
            )
    executor = make_executor('single')
    executor.add_node(node)
    processes = herding_stack('policy', shepherds, mode='realtime', rate=rate)
    with tempfile.TemporaryDirectory() as folder, running(Path(folder)) as started:
        started.start(processes)
        end = time.monotonic() + seconds + 10.0  # some for the start
        while time.monotonic() < end:
            executor.spin_once(timeout_sec=0.2)
            started.check()
    rclpy.try_shutdown()
    whole = [stamp for stamp, count in heard.items() if count == 4 * shepherds]
    return [1e-6 * (answered[stamp] - sent[stamp]) for stamp in sorted(whole)]


def quantile(values: list[float], share: float) -> float:
    """Return a quantile."""
    return sorted(values)[int(share * (len(values) - 1))]


def main() -> None:
    """Measure for one shepherd and for three; print a table and write JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=20.0, help='per number')
    parser.add_argument('--rate', type=float, default=20.0, help='steps per second')
    parser.add_argument('--shepherds', type=int, default=3)
    parser.add_argument('--json', default='')
    options = parser.parse_args()
    isolate(os.environ)
    torch.set_num_threads(1)
    rows = {
        'scan to command': stack(options.shepherds, options.rate, options.seconds),
        'bare network': bare(options.shepherds, options.seconds),
    }
    print(f'{options.shepherds} shepherds, one policy node, {options.rate:g} steps per second')
    print('| | answers | p50 [ms] | p99 [ms] |\n|---|--:|--:|--:|')
    result = {}
    for name, times in rows.items():
        result[name] = [quantile(times, 0.5), quantile(times, 0.99)]
        print(f'| {name} | {len(times)} | {result[name][0]:.2f} | {result[name][1]:.2f} |')
    ratios = [a / b for a, b in zip(*result.values(), strict=True)]
    print(f'| ratio | | {ratios[0]:.2f} | {ratios[1]:.2f} |')
    if options.json:
        Path(options.json).write_text(json.dumps(result, indent=1), encoding='utf-8')


if __name__ == '__main__':
    main()
