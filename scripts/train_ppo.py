#!/usr/bin/env python3
"""Train a policy from its reward: the same as `shepherd train ppo`."""

import sys

from shepherd_ros.cli import main

if __name__ == '__main__':
    sys.argv[1:1] = ['train', 'ppo']  # the record of the run names the whole command
    sys.exit(main())
