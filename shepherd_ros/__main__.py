"""The command `shepherd` as `python -m shepherd_ros`."""

import sys

from shepherd_ros.entry_points import shepherd

sys.exit(shepherd())
