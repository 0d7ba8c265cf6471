#!/usr/bin/env python3
"""Herd a flock with separate processes over ROS 2 topics: the same as `shepherd demo`."""

import sys

from shepherd_ros.cli import main

if __name__ == '__main__':
    sys.exit(main(['demo', *sys.argv[1:]]))
