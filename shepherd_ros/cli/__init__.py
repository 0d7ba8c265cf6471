"""The command `shepherd`: one verb a module."""

from __future__ import annotations

from collections.abc import Callable
import sys
from typing import Any

from shepherd_ros.config import ConfigError


class UserError(Exception):
    """A mistake of the user's or of the machine: what, what was expected, what to do."""


def main(arguments: list[str] | None = None) -> int:
    """Run a verb and return the exit code: 2 for a mistake of the user's, 130 for Ctrl-C."""
    from shepherd_ros.cli.bag import BagVerbs
    from shepherd_ros.cli.counterfactual import Counterfactual
    from shepherd_ros.cli.demo import Demo
    from shepherd_ros.cli.evaluate import Evaluate
    from shepherd_ros.cli.record import Record
    from shepherd_ros.cli.replay import Replay
    import tyro

    verbs: dict[str, Callable[..., Any]] = {
        'demo': Demo,
        'evaluate': Evaluate,
        'record': Record,
        'replay': Replay,
        'counterfactual': Counterfactual,
        'bag': BagVerbs,
    }
    try:
        verb = tyro.extras.subcommand_cli_from_dict(
            verbs, prog='shepherd', description='Herd with robots.', args=arguments
        )
        return int(verb.run())
    except (UserError, ConfigError) as error:
        print(f'shepherd: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
