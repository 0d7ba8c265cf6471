"""The command `shepherd` as `python -m shepherd_ros`."""

import sys

from shepherd_ros.cli import main

sys.exit(main())
