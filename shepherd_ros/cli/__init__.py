"""The command `shepherd`: one verb a module."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, MISSING
import os
import sys
from typing import Any

from shepherd_ros import __version__
from shepherd_ros.cli.user_error import UserError
from shepherd_ros.config import ConfigError
from shepherd_ros.resources import missing_package

__all__ = ['code', 'main', 'processes', 'train_help', 'train_verbs']


@dataclass
class Train:
    """Train a policy: shepherd train ppo, bc or dagger."""


@dataclass
class Run:
    """
    Start a node: shepherd run NODE, followed by its arguments, such as --ros-args.

    shepherd run NODE --help shows its parameters.
    """


def run_node(words: list[str]) -> int:
    """Run a node in this process, by its name and its arguments; return its exit code."""
    from shepherd_ros.config import unknown_name
    from shepherd_ros.nodes import executables

    if words[0] not in executables.FILES and words[0] not in (known := executables.names()):
        raise unknown_name('node', words[0], known)
    sys.argv = words
    return int(getattr(executables, words[0])())


def whole(words: list[str], verbs: dict[str, Callable[..., Any]]) -> list[str]:
    """Return the words, with --help added where a verb lacks all of its arguments."""
    alone = len(words) == 1 and words[0] in verbs
    if not words or (alone and (words[0] in ('train', 'run') or needs_more(verbs[words[0]]))):
        return [*words, '--help']
    return words


def needs_more(verb: Any) -> bool:
    """Return whether a verb has an argument without a default."""
    return any(f.default is MISSING and f.default_factory is MISSING for f in fields(verb))


def all_verbs() -> dict[str, Callable[..., Any]]:
    """Return the verbs by name."""
    from shepherd_ros.cli.bag_verbs import BagVerbs
    from shepherd_ros.cli.checkpoint_verbs import CheckpointVerbs
    from shepherd_ros.cli.console_verb import LiveConsole
    from shepherd_ros.cli.counterfactual_verb import Counterfactual
    from shepherd_ros.cli.dataset_verbs import DatasetVerbs
    from shepherd_ros.cli.demo_verb import Demo
    from shepherd_ros.cli.doctor_verb import Doctor
    from shepherd_ros.cli.evaluate_verb import Evaluate
    from shepherd_ros.cli.figures_verb import Figures
    from shepherd_ros.cli.record_verb import Record
    from shepherd_ros.cli.replay_verb import Replay
    from shepherd_ros.cli.search_verb import Search
    from shepherd_ros.cli.world_verbs import VERBS

    return {
        'demo': Demo,
        'console': LiveConsole,
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
        'run': Run,
        'doctor': Doctor,
        **VERBS,
    }


def _trainings() -> type[Any]:
    """Return the trainings as one verb, for completion in a shell."""
    from shepherd_ros.arguments import verb_group
    from shepherd_ros.cli.train_verbs import DEFAULT_RECIPES, verbs

    trainings: dict[str, Any] = dict(verbs(DEFAULT_RECIPES))
    return verb_group(Train.__doc__ or '', **trainings)


def main(arguments: list[str] | None = None) -> int:
    """Run a verb and return the exit code: 2 for a mistake of the user's, 130 for Ctrl-C."""
    try:
        import tyro

        verbs = all_verbs()
        words = whole(sys.argv[1:] if arguments is None else arguments, verbs)
        if words == ['--version']:
            print(f'shepherd_ros {__version__}')
            return 0
        if words[:1] == ['run'] and words[1] not in ('-h', '--help'):
            return run_node(words[1:])
        if words[:1] == ['train']:  # its arguments are made with torch, which takes a second
            from shepherd_ros.cli.train_verbs import train

            return train(words[1:], Train.__doc__ or '')
        if words[0].startswith('--tyro-'):  # completion, which knows the trainings, too
            verbs['train'] = _trainings()
        verb = tyro.extras.subcommand_cli_from_dict(
            verbs, prog='shepherd', description='Herd with robots.', args=words
        )
        return int(verb.run())
    except (UserError, ConfigError) as error:
        print(f'shepherd: {error}', file=sys.stderr)
        return 2
    except ModuleNotFoundError as error:
        print(f'shepherd: {missing_package(error)}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # a reader that has had enough, such as head
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
