#!/usr/bin/env python3
"""Write every episode of a simulation as a bag: the same as `shepherd record`."""

import sys

from shepherd_ros.cli import main

if __name__ == '__main__':
    sys.exit(main(['record', *sys.argv[1:]]))
