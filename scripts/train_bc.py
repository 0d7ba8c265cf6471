#!/usr/bin/env python3
"""Train a policy from bags or data sets: the same as `shepherd train bc`."""

import sys

from shepherd_ros.cli import main

if __name__ == '__main__':
    sys.argv[1:1] = ['train', 'bc']  # the record of the run names the whole command
    sys.exit(main())
