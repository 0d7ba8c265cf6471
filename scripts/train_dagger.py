#!/usr/bin/env python3
"""Train a policy from a teacher in simulation: the same as `shepherd train dagger`."""

import sys

from shepherd_ros.cli import main

if __name__ == '__main__':
    sys.argv[1:1] = ['train', 'dagger']  # the record of the run names the whole command
    sys.exit(main())
