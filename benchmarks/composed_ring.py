#!/usr/bin/env python3
"""The real ring in one process: arguments executor, controller, steps of an episode."""

import sys

import rclpy
from shepherd_ros.nodes.compose import compose
from shepherd_ros.nodes.runtime import spin
from shepherd_ros.stack import herding_stack
import torch


def main(executor: str, controller: str, steps: int) -> None:
    """Run two episodes; flock_sim logs when each began and ended."""
    torch.set_num_threads(1)
    rclpy.init(args=[])
    stack = herding_stack(
        controller, episode_steps=steps, episodes=2, wait_for_scans=True, executor=executor
    )
    nodes = compose([process for process in stack if process.executable != 'metrics'])
    spin(nodes, until=lambda: nodes[0].finished)
    rclpy.try_shutdown()


if __name__ == '__main__':
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
