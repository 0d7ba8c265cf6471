#!/usr/bin/env python3
"""
The bare ring: the messages of a stack with callbacks that do nothing but pass them on.

sim -> 3 lidars -> controller -> sim, with 100 poses as raw CDR and scans of 512 rays. With
--scans 3 each lidar sends all three channels, as the real stack does; the default is one.
"""

import argparse
from array import array
import time

from geometry_msgs.msg import PoseArray, TwistStamped
import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import LaserScan
from shepherd_ros.ros.runtime import make_executor
from shepherd_ros.wire.decode import decode_stamp
from shepherd_ros.wire.encode import encode_poses
import torch

LIDARS = 3
RELIABLE = QoSProfile(depth=10)
POSES = (np.zeros((100, 2)), np.tile([1.0, 0.0], (100, 1)))


class Sim(Node):
    """Sends poses, and the next ones when the command has come; counts the rounds."""

    def __init__(self, **kwargs: object) -> None:
        """Create the node."""
        super().__init__('sim', **kwargs)
        self.out = self.create_publisher(PoseArray, 'poses', RELIABLE)
        self.create_subscription(TwistStamped, 'cmd_vel', self.on_command, RELIABLE)
        self.create_timer(0.2, self.wake)
        self.rounds, self.heard = 0, 0.0

    def wake(self) -> None:
        """Send again if nobody has answered for long, as at the start."""
        if time.monotonic() - self.heard > 0.2:
            self.send()

    def send(self) -> None:
        """Send poses."""
        self.out.publish(encode_poses(self.rounds, 'map', *POSES))

    def on_command(self, message: TwistStamped) -> None:
        """Count a round and begin the next."""
        if message.header.stamp.nanosec == self.rounds % 10**9:
            self.rounds += 1
            self.heard = time.monotonic()
            self.send()


class Lidar(Node):
    """Answers poses with scans."""

    def __init__(self, index: int, scans: int, **kwargs: object) -> None:
        """Create the node."""
        super().__init__(f'lidar_{index}', **kwargs)
        self.out = [
            self.create_publisher(LaserScan, f'scan_{index}_{k}', RELIABLE) for k in range(scans)
        ]
        self.create_subscription(PoseArray, 'poses', self.on_poses, RELIABLE, raw=True)

    def on_poses(self, raw: bytes) -> None:
        """Send scans with the stamp of the poses."""
        for out in self.out:
            message = LaserScan(ranges=array('f', bytes(4 * 512)))
            message.header.stamp.nanosec = decode_stamp(raw) % 10**9
            out.publish(message)


class Controller(Node):
    """Answers a full set of scans with a command."""

    def __init__(self, scans: int, **kwargs: object) -> None:
        """Create the node."""
        super().__init__('controller', **kwargs)
        self.out = self.create_publisher(TwistStamped, 'cmd_vel', RELIABLE)
        self.seen: dict[tuple[int, int], int] = {}
        self.all = LIDARS * scans
        for index in range(LIDARS):
            for k in range(scans):
                self.create_subscription(
                    LaserScan, f'scan_{index}_{k}',
                    lambda message, key=(index, k): self.on_scan(key, message), RELIABLE,
                )  # fmt: skip

    def on_scan(self, key: tuple[int, int], message: LaserScan) -> None:
        """Send a command once all scans of one stamp are there."""
        stamp = message.header.stamp
        self.seen[key] = stamp.nanosec
        if sum(value == stamp.nanosec for value in self.seen.values()) == self.all:
            command = TwistStamped()
            command.header.stamp = stamp
            self.out.publish(command)


def main() -> None:
    """Run one role, or all in one process; the one with the sim prints rounds per second."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('role', help='sim, controller, all, or the index of a lidar')
    parser.add_argument('--scans', type=int, default=1, help='scans per lidar and round')
    parser.add_argument('--executor', default='single', choices=('single', 'events'))
    parser.add_argument('--seconds', type=float, default=10.0)
    parser.add_argument('--clock', default='wall', choices=('wall', 'cpu'))
    options = parser.parse_args()
    torch.set_num_threads(1)
    rclpy.init()
    make = {
        'sim': Sim,
        **{str(i): lambda i=i: Lidar(i, options.scans) for i in range(LIDARS)},
        'controller': lambda: Controller(options.scans),
    }
    nodes = [make[role]() for role in (make if options.role == 'all' else [options.role])]
    executor = make_executor(options.executor)
    for node in nodes:
        executor.add_node(node)
    sim = next((node for node in nodes if isinstance(node, Sim)), None)
    now = time.thread_time if options.clock == 'cpu' else time.monotonic
    begun, start = 0.0, 0
    while rclpy.ok():
        executor.spin_once(timeout_sec=0.5)
        if sim is not None and not begun and sim.rounds > 200:
            begun, start = now(), sim.rounds
        if begun and sim is not None and now() - begun > options.seconds:
            print((sim.rounds - start) / (now() - begun), flush=True)
            break
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
