"""Verbs train ppo, bc and dagger: from the simulator or from bags to a checkpoint."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, make_dataclass, replace
from datetime import timedelta
from pathlib import Path
import shlex
from typing import Annotated, Any

from shepherd_ros import __version__
from shepherd_ros.arguments import arguments_of, configured
from shepherd_ros.cli.code import commit
from shepherd_ros.cli.out_folders import claimed_folder
from shepherd_ros.cli.progress import progress
from shepherd_ros.cli.train_help import BAGS, COMMON, print_help
from shepherd_ros.cli.train_tasks import for_task, other_task, progress_names
from shepherd_ros.cli.user_error import UserError
from shepherd_ros.config import Config
from shepherd_ros.learning.annealing import stages
from shepherd_ros.learning.dagger import train_dagger
from shepherd_ros.learning.dagger_config import DaggerConfig
from shepherd_ros.learning.distributed import device_index, rank, ranks
from shepherd_ros.learning.ppo import PPOConfig
from shepherd_ros.learning.run_folder import RunFolder
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.learning.train_bc import BCConfig, train_bc
from shepherd_ros.learning.train_ppo import PPORunConfig, train_ppo
from shepherd_ros.memory import keep_memory
from shepherd_ros.policy.checkpoint import load_policy
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.policy.warm_start import warm_start
from shepherd_ros.sim.observation import ObservationConfig
import torch
import tyro

# what works on a CPU; the defaults of the policy itself are the paper's
LEARNS_WELL = ObservationConfig(align='goal', unit=10.0)
RING = replace(LEARNS_WELL, layout='ring')
FROM_SCRATCH = PolicyConfig(
    decision_interval=4.0,
    observation=replace(LEARNS_WELL, frame_interval=4.0),
    network=NetworkConfig(min_std=0.2),
)
SMALL_RING = PolicyConfig(
    decision_interval=4.0,
    observation=replace(RING, frame_interval=4.0),
    network=NetworkConfig(filters_1=16, filters_2=32, hidden=128, padding='circular', min_std=0.2),
)
IMITATION = PolicyConfig(observation=replace(LEARNS_WELL, frame_interval=2.0))
IMITATION_RING = PolicyConfig(
    observation=replace(RING, frame_interval=2.0), network=NetworkConfig(padding='circular')
)


@dataclass(frozen=True)
class Recipe:
    """Configurations of a policy and of its training, before options change them."""

    policy: PolicyConfig
    run: Config


DEFAULT_RECIPES = {
    'ppo': Recipe(FROM_SCRATCH, PPORunConfig()),
    'dagger': Recipe(IMITATION, DaggerConfig()),
    'bc': Recipe(IMITATION, BCConfig()),
}
QUICK_RECIPES = {
    'ppo': Recipe(
        SMALL_RING,
        PPORunConfig(
            samples=1_000_000,
            task=TaskConfig(goal_radius_max=6.0, home_share=0.35),
            ppo=PPOConfig(actor_learning_rate=2.5e-4, critic_learning_rate=6e-4),
        ),
    ),
    'dagger': Recipe(IMITATION_RING, DaggerConfig(rounds=40)),
    'bc': Recipe(IMITATION_RING, BCConfig(epochs=2)),
}

TRAININGS = {
    'ppo': 'Train a policy by reinforcement, with PPO in batches of worlds.',
    'dagger': 'Train a policy to do what a teacher would do where the policy goes, with DAgger.',
    'bc': 'Train a policy to repeat the commands in bags, by behaviour cloning.',
}


@dataclass
class _Common:
    """Options that all trainings have."""

    out: Annotated[Path, tyro.conf.arg(help=COMMON['out'][1])]
    pretrained: Annotated[str, tyro.conf.arg(help=COMMON['pretrained'][1])] = ''
    quick: Annotated[bool, tyro.conf.arg(help=COMMON['quick'][1])] = False
    threads: Annotated[int, tyro.conf.arg(help=COMMON['threads'][1])] = 1
    device: Annotated[str, tyro.conf.arg(help=COMMON['device'][1])] = 'cpu'


def verb(name: str, recipe: Recipe, train: Callable[..., Any]) -> type[Any]:
    """Return the class of a verb, with the arguments of its configuration."""
    kind = type(recipe.run)

    def run(arguments: Any) -> int:
        return _run(arguments, kind, train)

    rows: list[Any] = []
    if kind is BCConfig:
        positional = Annotated[tuple[Path, ...], tyro.conf.arg(help=BAGS)]
        rows.append(('bags', tyro.conf.Positional[positional], ()))
    policy_arguments, config = arguments_of(recipe.policy), arguments_of(recipe.run)
    flat: Any = tyro.conf.OmitArgPrefixes
    rows += [
        ('policy', policy_arguments, field(default_factory=policy_arguments)),
        ('run_', flat[config], field(default_factory=config)),
    ]
    names = {'__doc__': TRAININGS[name], 'run': run}
    return make_dataclass(kind.__name__, rows, bases=(_Common,), namespace=names, kw_only=True)


def verbs(recipes: Mapping[str, Recipe]) -> dict[str, Callable[..., Any]]:
    """Return the verbs of training by name."""
    trainings: dict[str, Callable[..., Any]] = {
        'ppo': train_ppo, 'dagger': train_dagger, 'bc': train_bc
    }  # fmt: skip
    return {name: verb(name, recipes[name], training) for name, training in trainings.items()}


def train(words: list[str], doc: str) -> int:
    """Run the verb that words of a command line name; return the exit code."""

    def parsed(recipes: Mapping[str, Recipe]) -> Any:
        return tyro.extras.subcommand_cli_from_dict(
            verbs(recipes), prog='shepherd train', description=doc, args=words
        )

    if words[:1] and words[0] in TRAININGS and {'-h', '--help', '--help-policy'} & {*words}:
        recipe = (QUICK_RECIPES if '--quick' in words else DEFAULT_RECIPES)[words[0]]
        print_help(
            words[0], TRAININGS[words[0]], recipe.run, recipe.policy, '--help-policy' in words
        )
        return 0
    chosen = parsed(DEFAULT_RECIPES)
    recipes = QUICK_RECIPES if chosen.quick else DEFAULT_RECIPES
    if chosen.pretrained:  # what is not said about the policy is as in the checkpoint
        policy = load_policy(chosen.pretrained).config
        recipes = {name: replace(recipe, policy=policy) for name, recipe in recipes.items()}
    if task := other_task(chosen):
        recipes = {name: for_task(recipe, task) for name, recipe in recipes.items()}
    if recipes is not DEFAULT_RECIPES:
        chosen = parsed(recipes)
    chosen.command = shlex.join(['shepherd', 'train', *words])
    return int(chosen.run())


def _run(arguments: Any, kind: type[Config], train: Callable[..., Any]) -> int:
    """Train in the run folder; return the exit code."""
    if arguments.threads < 1:
        raise UserError(f'--threads is {arguments.threads}: expected at least 1')
    if kind is BCConfig and not arguments.bags:
        raise UserError('no bags are given: expected bags or folders of bags, as arguments')
    check_device(arguments.device, kind)
    if ranks() > 1 and kind is not PPORunConfig:
        raise UserError(
            f'torchrun has started {ranks()} processes: expected one, only PPO trains in several'
        )
    if arguments.device == 'cuda':
        torch.cuda.set_device(device_index())
    torch.set_num_threads(arguments.threads)
    keep_memory()
    config = configured(kind, arguments.run_)
    torch.manual_seed(arguments.run_.seed)
    policy = _policy(arguments).to(arguments.device)
    assert isinstance(config, PPORunConfig | DaggerConfig | BCConfig)
    held = [policy.config]
    if isinstance(config, PPORunConfig):
        held = stages(policy.config, config.anneal)
    deviations = (stage.timing(config.task.dt).deviation for stage in held)
    for deviation in dict.fromkeys(filter(None, deviations)):
        print(f'the policy {deviation}')
    record = {
        'command': arguments.command,
        'code': commit(),
        'version': __version__,
        'torch': torch.__version__,
        'config': {
            'policy': policy.config,
            'run': config,
            'pretrained': arguments.pretrained,
            **({'bags': [str(place) for place in arguments.bags]} if kind is BCConfig else {}),
        },
    }
    if rank() == 0:
        claimed_folder('--out', arguments.out, 'run.json lock')
    run = RunFolder(arguments.out, record)
    if kind is BCConfig:
        with progress('reading') as tell:
            report = train(policy, arguments.bags, config, run, show, tell)
        print(report.text() if report.bags else '', end='\n' * bool(report.bags))
    else:
        train(policy, config, run, show)
    if rank() == 0:
        print(f'the best policy is in {run.best}')
    return 0


def check_device(device: str, kind: type[Config]) -> None:
    """Raise UserError for a device that is not there, or that a training cannot use."""
    if device not in ('cpu', 'cuda'):
        raise UserError(f'--device is {device!r}: expected cpu or cuda')
    if device == 'cuda' and kind is not PPORunConfig:
        raise UserError('--device is cuda: expected cpu, only PPO trains on a GPU')
    if device == 'cuda' and not torch.cuda.is_available():
        raise UserError(
            '--device is cuda: expected cpu, as torch finds no GPU here; on a machine with one, '
            'install a torch that was built for it'
        )


def _policy(arguments: Any) -> Policy:
    """Return the policy to train: new, or with the weights of a checkpoint."""
    policy = Policy(configured(PolicyConfig, arguments.policy))
    if arguments.pretrained:
        try:
            new_critic = getattr(arguments.run_, 'new_critic', False)
            warm_start(policy, load_policy(arguments.pretrained), new_critic)
        except RuntimeError as error:
            raise UserError(
                f'--pretrained {arguments.pretrained} does not fit: {error}; leave out the '
                '--policy options that change the form of the network'
            ) from error
    return policy


def show(line: dict[str, Any]) -> None:
    """Print the progress of a training."""
    left = timedelta(seconds=int(line['seconds_left']))
    parts = [f'{line["updates"]:5d} updates', f'{line["samples"]:9,d} samples']
    watched = [name for name in ('reward', 'loss', 'kl', 'std') if name in line]
    parts += [f'{name} {line[name]:.4f}' for name in watched]
    parts += [
        f'{name} {line["eval/" + name]:.3f}'
        for name in ('held_out_error', 'gate_accuracy', 'return', *progress_names())
        if 'eval/' + name in line
    ]
    parts.append(f'{left} left')
    print('  '.join(parts), flush=True)
