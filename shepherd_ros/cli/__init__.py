"""The command `shepherd`: one verb a module."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import os
import sys
from typing import Any

from shepherd_ros.cli.user_error import UserError
from shepherd_ros.config import ConfigError

__all__ = ['code', 'main', 'processes']


@dataclass
class Train:
    """Train a policy: shepherd train ppo, bc or dagger."""

    def run(self) -> int:
        """Print the missing choice of a training."""
        raise UserError('train needs to be told how: expected shepherd train ppo, bc or dagger')


def main(arguments: list[str] | None = None) -> int:
    """Run a verb and return the exit code: 2 for a mistake of the user's, 130 for Ctrl-C."""
    from shepherd_ros.cli.bag_verbs import BagVerbs
    from shepherd_ros.cli.checkpoint_verbs import CheckpointVerbs
    from shepherd_ros.cli.counterfactual_verb import Counterfactual
    from shepherd_ros.cli.dataset_verbs import DatasetVerbs
    from shepherd_ros.cli.demo_verb import Demo
    from shepherd_ros.cli.evaluate_verb import Evaluate
    from shepherd_ros.cli.figures_verb import Figures
    from shepherd_ros.cli.record_verb import Record
    from shepherd_ros.cli.replay_verb import Replay
    from shepherd_ros.cli.search_verb import Search
    import tyro

    verbs: dict[str, Callable[..., Any]] = {
        'demo': Demo,
        'evaluate': Evaluate,
        'figures': Figures,
        'search': Search,
        'record': Record,
        'replay': Replay,
        'counterfactual': Counterfactual,
        'bag': BagVerbs,
        'dataset': DatasetVerbs,
        'train': Train,
        'checkpoint': CheckpointVerbs,
    }
    words = sys.argv[1:] if arguments is None else arguments
    try:
        if words[:1] == ['train']:  # its arguments are made with torch, which takes a second
            from shepherd_ros.cli.train_verbs import train

            return train(words[1:], Train.__doc__ or '')
        verb = tyro.extras.subcommand_cli_from_dict(
            verbs, prog='shepherd', description='Herd with robots.', args=words
        )
        return int(verb.run())
    except (UserError, ConfigError) as error:
        print(f'shepherd: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # a reader that has had enough, such as head
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
