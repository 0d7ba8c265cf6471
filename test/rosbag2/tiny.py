"""
A tiny recording for tests: two episodes of 4 steps, 5 sheep, 2 shepherds, 16 rays.

The worlds come from the pure simulation, the bytes from rosbags: neither shares code with the
layer under test.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
import json
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from rosbags.typesys import get_typestore, Stores
from shepherd_ros.recordings.recording_writer import offered_qos, RecordingWriter
from shepherd_ros.rosbag2.writer import BagWriter
from shepherd_ros.sim import compiled
from shepherd_ros.sim.lidar import LidarConfig, scan
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.transition import step
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.wire.contract import known, known_text, type_hash
from shepherd_ros.wire.topics import contract
import torch

N_SHEEP, N_SHEPHERDS, STEPS, RAYS, EPISODES = 5, 2, 4, 16, 2
DT_NS = 500_000_000
LOG_START_NS = 1_700_000_000_000_000_000
STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = {
    'PoseArray': 'geometry_msgs/msg/PoseArray',
    'PoseStamped': 'geometry_msgs/msg/PoseStamped',
    'TwistStamped': 'geometry_msgs/msg/TwistStamped',
    'LaserScan': 'sensor_msgs/msg/LaserScan',
    'Clock': 'rosgraph_msgs/msg/Clock',
    'String': 'std_msgs/msg/String',
    'Float64': 'std_msgs/msg/Float64',
}


class Sent(NamedTuple):
    """A message on its way into a bag."""

    topic: str
    type: str
    data: bytes
    log_ns: int
    publish_ns: int


@dataclass(frozen=True)
class Truth:
    """What was put into the recording for one state."""

    episode: int
    step: int
    stamp_ns: int
    sheep: np.ndarray
    sheep_heading: np.ndarray
    shepherds: np.ndarray
    goal: np.ndarray
    scans: np.ndarray  # (H, 3, R)
    commands: np.ndarray  # (H, 2)


def make(kind: str, **fields: Any) -> Any:
    """Return a message of rosbags; a name is that of the type without its package."""
    names = (
        'geometry_msgs/msg/', 'std_msgs/msg/', 'builtin_interfaces/msg/', 'sensor_msgs/msg/',
        'rosgraph_msgs/msg/', 'diagnostic_msgs/msg/',
    )  # fmt: skip
    name = next(space + kind for space in names if space + kind in STORE.types)
    return STORE.types[name](**fields)


def cdr(message: Any) -> bytes:
    """Return a message of rosbags as CDR."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def header(ns: int, frame_id: str = 'world') -> Any:
    """Return a std_msgs/Header."""
    time = make('Time', sec=ns // 10**9, nanosec=ns % 10**9)
    return make('Header', stamp=time, frame_id=frame_id)


def poses(ns: int, xy: np.ndarray, heading: np.ndarray, frame_id: str = 'world') -> bytes:
    """Return a PoseArray of positions (K, 2) and headings (K, 2)."""
    rows = []
    for (x, y), (c, s) in zip(xy.tolist(), heading.tolist(), strict=True):
        yaw = np.arctan2(s, c)
        turn = make('Quaternion', x=0.0, y=0.0, z=np.sin(yaw / 2), w=np.cos(yaw / 2))
        rows.append(make('Pose', position=make('Point', x=x, y=y, z=0.0), orientation=turn))
    return cdr(make('PoseArray', header=header(ns, frame_id), poses=rows))


def scan_of(ns: int, ranges: np.ndarray, frame_id: str = 'shepherd_0') -> bytes:
    """Return a LaserScan of ranges (R,)."""
    pitch = 2 * np.pi / max(len(ranges), 1)
    return cdr(
        make(
            'LaserScan', header=header(ns, frame_id), angle_min=0.0,
            angle_max=(len(ranges) - 1) * pitch, angle_increment=pitch, time_increment=0.0,
            scan_time=0.5, range_min=0.0, range_max=40.0, ranges=ranges.astype(np.float32),
            intensities=np.zeros(0, np.float32),
        )
    )  # fmt: skip


def twist(x: float, y: float) -> Any:
    """Return a Twist."""
    still = make('Vector3', x=0.0, y=0.0, z=0.0)
    return make('Twist', linear=make('Vector3', x=x, y=y, z=0.0), angular=still)


def pose(ns: int, x: float, y: float) -> bytes:
    """Return a PoseStamped."""
    turn = make('Quaternion', x=0.0, y=0.0, z=0.0, w=1.0)
    place = make('Pose', position=make('Point', x=x, y=y, z=0.0), orientation=turn)
    return cdr(make('PoseStamped', header=header(ns), pose=place))


def episode_text(number: int, start_ns: int, world: WorldConfig) -> str:
    """Return the content of the topic episode."""
    return json.dumps(
        {
            'schema': 1, 'number': number, 'seed': 7 + number, 'version': '0.1.0',
            'start': {'sec': start_ns // 10**9, 'nanosec': start_ns % 10**9},
            'n_sheep': world.n_sheep, 'n_shepherds': world.n_shepherds, 'goal_radius': 4.0,
            'frame_id': 'world', 'mode': 'lockstep', 'world': world.to_dict(),
        },
        sort_keys=True,
    )  # fmt: skip


def _states(world: WorldConfig, seed: int) -> Iterable[tuple[WorldState, torch.Tensor]]:
    """Yield states of an episode and the commands (H, 2) that answer them."""
    state = spawn(world, torch.tensor(seed))
    for _ in range(world.episode_steps + 1):
        command = 0.5 * (state.sheep.mean(dim=0) - state.shepherds).clamp(-1, 1)
        yield state, command
        state = step(state, command, world)


@cache
@patch.object(compiled, 'HAS_NUMBA', False)  # nothing to compile where tests are collected
def recording(steps: int = STEPS) -> tuple[tuple[Sent, ...], tuple[Truth, ...]]:
    """Return all messages in the order of their log times, and what they say."""
    sent: list[Sent] = []
    truth = []
    lidar = LidarConfig(n_rays=RAYS)
    world = WorldConfig(
        n_sheep=N_SHEEP, n_shepherds=N_SHEPHERDS, dt=DT_NS / 1e9, episode_steps=steps
    )

    def send(topic: str, kind: str, data: bytes) -> None:
        log_ns = LOG_START_NS + 1_000_000 * len(sent)
        sent.append(Sent(topic, TYPES[kind], data, log_ns, log_ns - 100_000))

    for number in range(EPISODES):
        start = DT_NS * (1 + number * (steps + 1))
        send('/episode', 'String', cdr(make('String', data=episode_text(number, start, world))))
        for k, (state, command) in enumerate(_states(world, 7 + number)):
            ns, heading = start + k * DT_NS, state.heading.numpy()
            if k == 0:
                send('/goal', 'PoseStamped', pose(ns, *state.goal.tolist()))
            still = np.tile([1.0, 0.0], (N_SHEPHERDS, 1))
            clock = make('Clock', clock=make('Time', sec=ns // 10**9, nanosec=ns % 10**9))
            send('/clock', 'Clock', cdr(clock))
            send('/shepherds/poses', 'PoseArray', poses(ns, state.shepherds.numpy(), still))
            send('/flock/poses', 'PoseArray', poses(ns, state.sheep.numpy(), heading))
            ranges = scan(state, lidar).numpy()
            for h in range(N_SHEPHERDS):
                for row, channel in zip(ranges[h], PAPER_CHANNELS, strict=True):
                    data = scan_of(ns, row, f'shepherd_{h}')
                    send(f'/shepherd_{h}/scan/{channel}', 'LaserScan', data)
            for h, (x, y) in enumerate(command.tolist()):
                answer = make('TwistStamped', header=header(ns), twist=twist(x, y))
                send(f'/shepherd_{h}/cmd_vel', 'TwistStamped', cdr(answer))
            spread = cdr(make('Float64', data=float(k)))
            send('/metrics/flock_spread', 'Float64', spread)
            truth.append(
                Truth(
                    number, k, ns, state.sheep.numpy(), heading, state.shepherds.numpy(),
                    state.goal.numpy(), ranges, command.numpy(),
                )
            )  # fmt: skip
    return tuple(sent), tuple(truth)


def write(folder: Path, messages: Iterable[Sent], *, own: bool = True, **options: Any) -> Path:
    """
    Write messages as a bag, each topic with the profile of the contract; return the folder.

    own=False: without what recordings of the project say of themselves.
    """
    profiles = contract()[1]
    with (RecordingWriter if own else BagWriter)(folder, **options) as writer:
        for topic, kind, data, log_ns, publish_ns in messages:
            actual = known(topic)
            qos = [offered_qos(profiles[actual.topic.profile])] if actual else []
            schema = 'ros2msg', known_text(kind)
            writer.add_topic(topic, kind, qos, schema=schema, hash_text=type_hash(kind))
            writer.write(topic, data, log_ns, publish_ns)
    return folder


def tiny_bag(folder: Path, **options: Any) -> Path:
    """Write the tiny recording; return the folder."""
    return write(folder, recording()[0], **options)


def without(messages: Iterable[Sent], topic: str, index: int) -> list[Sent]:
    """Return messages without the index-th of a topic."""
    rows = list(messages)
    places = [i for i, message in enumerate(rows) if message.topic == topic]
    del rows[places[index]]
    return rows


def moved(message: Sent, **fields: Any) -> Sent:
    """Return a message with other fields."""
    return message._replace(**fields)
