#!/usr/bin/env python3
"""Export bags as a data set in Parquet: the same as `shepherd dataset build`."""

import sys

from shepherd_ros.cli import main

if __name__ == '__main__':
    sys.exit(main(['dataset', 'build', *sys.argv[1:]]))
