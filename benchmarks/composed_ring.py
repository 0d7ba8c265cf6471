#!/usr/bin/env python3
"""
The real ring in one process: arguments executor, controller, steps of an episode, clock.

Prints cycles per second of the second of two episodes, by wall time or by CPU time of its thread.
"""

import sys
import time

import rclpy
from shepherd_ros.bringup import herding_stack
from shepherd_ros.nodes.compose import compose
from shepherd_ros.ros.runtime import spin
import torch


def main(executor: str, controller: str, steps: int, clock: str = 'wall') -> None:
    """Run two episodes and measure the second."""
    now = time.thread_time if clock == 'cpu' else time.monotonic
    begun: list[float] = []
    torch.set_num_threads(1)
    rclpy.init(args=[])
    stack = herding_stack(
        controller, episode_steps=steps, episodes=2, wait_for_scans=True, executor=executor
    )
    nodes = compose([process for process in stack if process.executable != 'metrics'])
    sim = nodes[0]

    def ended() -> bool:
        if sim.number == 1 and not begun:
            begun.append(now())
        return sim.finished

    spin(nodes, until=ended)
    print(f'{(steps + 1) / (now() - begun[0])} cycles per second', flush=True)
    rclpy.try_shutdown()


if __name__ == '__main__':
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), *sys.argv[4:])
