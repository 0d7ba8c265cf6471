"""Write msg_schemas/ anew: texts from the installed packages, episode from the configuration."""

from __future__ import annotations

import json
from pathlib import Path
import sys

from shepherd_ros.bags.schemas import installed_text, nested_text, schema_name, wire_types
from shepherd_ros.nodes.episode_schema import episode_schema

FOLDER = Path(__file__).resolve().parents[1] / 'msg_schemas'


def main() -> int:
    """Write every file that is made from something else."""
    return 0


if __name__ == '__main__':
    sys.exit(main())
