#!/usr/bin/env python3
"""Compare controllers on many episodes: the same as `shepherd evaluate`."""

import sys

from shepherd_ros.cli import main

if __name__ == '__main__':
    sys.exit(main(['evaluate', *sys.argv[1:]]))
