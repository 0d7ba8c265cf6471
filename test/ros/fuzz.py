"""
Mutated messages on every topic of every node: `python test/ros/fuzz.py SEED COUNT`.

Each node hears messages that another machine might send: cut, with wrong bytes, with numbers and
texts that are extreme or senseless. The last line of the output is JSON: how many messages were
heard, and how much the memory of the process has grown since the first quarter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import deepcopy
import json
from pathlib import Path
import random
import resource
import struct
import sys
import tempfile
from typing import Any

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.logging import LoggingSeverity
from shepherd_ros.nodes.compose import NODES
from shepherd_ros.nodes.recorder_node import Recorder
from shepherd_ros.nodes.recorder_options import RecorderOptions
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.wire.encode import (
    encode_clock,
    encode_command,
    encode_goal,
    encode_number,
    encode_poses,
    encode_scan,
    encode_text,
    encode_twist,
)
from shepherd_ros.wire.episode import Episode

SHEEP, SHEPHERDS, STEPS, RAYS = 7, 2, 50, 512
START = 500_000_000  # [ns]
NODES_WITH = [
    ('flock_sim', {'n_sheep': SHEEP, 'n_shepherds': SHEPHERDS, 'episode_steps': STEPS}),
    ('flock_sim', {'n_sheep': SHEEP, 'mode': 'realtime', 'stamped': False}),
    ('flock_sim', {'n_sheep': SHEEP, 'n_shepherds': SHEPHERDS, 'wait_for_scans': True}),
    ('lidar', {'shepherd_ids': [0, 1]}),
    ('metrics', {}),
    ('policy', {'shepherd_ids': [0, 1]}),
    *((name, {}) for name in ('strombom', 'pierson', 'drover', 'random')),
]
NUMBERS = [0, 1, 2, 0x7F, 0xFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 4_000_000_000]
FLOATS = [np.nan, np.inf, -np.inf, -0.0, 5e-324, 1e38, -3.5e38, 1e300, 1e10, -1.0]
VALUES: list[Any] = [
    None, True, -1, 0, 2**31, 2**63, 2**70, -(2**70), 10**4000, 1.5, float('nan'), float('inf'),
    1e308, 5e-324, '', 'x' * 4000, '\ud800', '\0', [], {}, [[]], {'a': {}}, 'lockstep', 'map',
]  # fmt: skip


def episode(rng: random.Random) -> str:
    """Return an episode as JSON, with a value or two that are no good."""
    world = WorldConfig(n_sheep=SHEEP, n_shepherds=SHEPHERDS, episode_steps=STEPS)
    made = Episode(0, 0, START, SHEEP, SHEPHERDS, 4.0, 'map', 'lockstep', world.to_dict())
    data = json.loads(made.to_json())
    for _ in range(rng.randrange(3)):
        part = data
        while True:
            key = rng.choice(sorted(part))
            if not isinstance(part[key], dict) or not part[key] or rng.random() < 0.1:
                break
            part = part[key]
        chance = rng.random()
        if chance < 0.1:
            del part[key]
        elif chance < 0.2:
            part['x' * rng.choice([0, 1, 10_000])] = deepcopy(rng.choice(VALUES))
        else:
            part[key] = deepcopy(rng.choice([*VALUES, rng.randrange(1000), rng.random() * 100]))
    text = json.dumps(data)
    if rng.random() < 0.02:
        text = rng.choice(['[' * 200_000, '{"a":' * 5_000, '9' * 5_000, '"' * 9, text * 2])
    return text


def well_formed(kind: str, rng: random.Random) -> bytes:
    """Return a message of a type as its sender means it."""
    ns = START * rng.choice([1, 1, 2, 3, STEPS, rng.randrange(1, 4 * STEPS)])
    x, y = (rng.choice([rng.gauss(0, 30), *FLOATS]) for _ in range(2))
    name = kind.split('/')[-1]
    if name == 'PoseArray':
        count = rng.choice([SHEEP, SHEPHERDS])
        xy = np.random.default_rng(rng.randrange(2**32)).normal(0, 30, (count, 2))
        if rng.random() < 0.2:
            xy[rng.randrange(count)] = x, y
        return encode_poses(ns, 'map', xy, np.ones((count, 2)))
    if name == 'LaserScan':
        ranges = np.full(RAYS, rng.choice([1.0, 5.0, *FLOATS]))
        with np.errstate(over='ignore'):
            return encode_scan(ns, f'shepherd_{rng.randrange(2)}', ranges, 40.0, 0.5)
    if name == 'String':
        return encode_text(episode(rng))
    return {
        'PoseStamped': encode_goal(ns, 'map', x, y),
        'TwistStamped': encode_command(ns, 'map', x, y),
        'Twist': encode_twist(x, y),
        'Clock': encode_clock(ns),
        'Float64': encode_number(x),
    }.get(name, bytes([0, 1, 0, 0]) + rng.randbytes(40))


def mutated(raw: bytes, rng: random.Random) -> bytes:
    """Return a message with some damage, or none."""
    data = bytearray(raw)
    for _ in range(rng.choice([0, 1, 1, 2, 5])):
        damage, near = rng.randrange(6), rng.random() < 0.7
        at = rng.randrange(min(len(data), 64) if near else len(data)) if data else 0
        if damage == 0:
            del data[at:]
        elif damage == 1 and data:
            data[at] = rng.choice([0, 1, 0x80, 0xFC, 0xFF, rng.randrange(256)])
        elif damage == 2 and len(data) >= 4:
            struct.pack_into('<I', data, min(at // 4 * 4, len(data) - 4), rng.choice(NUMBERS))
        elif damage == 3 and len(data) >= 8:
            struct.pack_into('<d', data, min(at // 4 * 4, len(data) - 8), rng.choice(FLOATS))
        elif damage == 4:
            data[at:at] = rng.randbytes(rng.choice([1, 4, 8, 100]))
        elif damage == 5:
            del data[at : at + rng.choice([1, 4, 8])]
    return bytes(data)


@contextmanager
def listening(folder: Path) -> Iterator[list[ShepherdNode]]:
    """Give nodes of every kind that nobody spins."""
    context, apart = Context(), Context()  # a process cannot have two types on one topic
    for each in (context, apart):
        rclpy.init(args=[], context=each)
    nodes: list[ShepherdNode] = []
    for number, (name, given) in enumerate(NODES_WITH):
        words = [w for k, v in given.items() for w in ('-p', f'{k}:={json.dumps(v)}')]
        words = ['--ros-args', *words, '-r', f'__ns:=/n{number}']
        nodes.append(NODES[name](context=context, cli_args=words, use_global_arguments=False))
    options = RecorderOptions(all=True, output=str(folder / 'bag'), use_sim_time=True)
    nodes.append(Recorder(options, context=apart, use_global_arguments=False))
    for node in nodes:
        node.get_logger().set_level(LoggingSeverity.FATAL)
    try:
        yield nodes
    finally:
        for node in nodes:
            node.end()
            node.destroy_node()
        for each in (context, apart):
            each.try_shutdown()


def ears(nodes: list[ShepherdNode]) -> list[tuple[str, Callable[[bytes], None]]]:
    """Return type and callback of everything that hears messages."""
    found: list[tuple[str, Callable[[bytes], None]]] = []
    times = {'received_timestamp': 1, 'source_timestamp': 1}
    for node in nodes:
        if isinstance(node, Recorder):
            found += [
                (received.kind, lambda raw, node=node, name=name: node.receive(name, raw, times))
                for name, received in node.subscribed.inputs.items()
            ]
        else:
            found += [(type_name(s.msg_type), s.callback) for s in node.subscriptions if s.raw]
    return found


def type_name(kind: Any) -> str:
    """Return the name of a message class, such as geometry_msgs/msg/Pose."""
    return f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'


def speak(nodes: list[ShepherdNode], rng: random.Random, count: int) -> int:
    """
    Let the nodes hear so many messages, and run their timers from time to time.

    Return how many bytes they have heard.
    """
    total = 0  # [bytes]
    for k in range(count):
        if k % 50 == 0:
            received = ears(nodes)
            for kind, deliver in received:  # most go on from a good episode
                if kind.endswith('String'):
                    deliver(encode_text(episode(random.Random(1))))
            for node in nodes:
                for timer in node.timers:
                    timer.callback()
                assert not node.finished, node.get_name()
        kind, deliver = rng.choice(received)
        raw = mutated(well_formed(kind, rng), rng)
        total += len(raw)
        deliver(raw)
    return total


def resident() -> float:
    """Return the memory of this process [MiB]."""
    pages = int(Path('/proc/self/statm').read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def main() -> None:
    """Let all nodes hear mutated messages."""
    seed, count = (int(word) for word in sys.argv[1:])
    with tempfile.TemporaryDirectory() as folder, listening(Path(folder)) as nodes:
        rng = random.Random(seed)
        speak(nodes, rng, count // 4)
        before = resident()
        mib = speak(nodes, rng, count - count // 4) / 2**20
        numbers = {'mib': round(mib, 1), 'grown_mib': round(resident() - before, 1)}
        print(json.dumps({'heard': count, 'since_the_first_quarter': numbers}))


if __name__ == '__main__':
    main()
