"""Help of trainings: every option with default and meaning in a line or two, by group."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text
from shepherd_ros.config import choices_of, Config

COMMON = {  # of all trainings: default and meaning
    'out': (None, 'folder of the run; one that was interrupted goes on'),
    'pretrained': ('', 'checkpoint to start from, a file or a shipped name; with its --policy'),
    'quick': (False, 'first result in ten minutes, small network'),
    'threads': (1, 'threads of torch'),
    'device': ('cpu', 'of worlds and networks of PPO: cpu or cuda'),
}
BAGS = 'bags, folders of bags, or data sets of `shepherd dataset build`'
_TITLES = {
    'evaluation': 'Evaluation: how the policy that is kept is chosen',
    'task': 'Episodes: evenly drawn between -min and -max',
    'reward': 'Reward',
    'anneal': 'Pace: actions are held for ever shorter',
    'ppo': 'Update',
    'clone': 'Update',
}
_POLICY = 'policy'


@dataclass(frozen=True)
class OptionRow:
    """An option as help shows it."""

    name: str  # such as --samples
    default: str
    text: str


def option_groups(run: Config) -> Iterator[tuple[str, list[OptionRow]]]:
    """Yield title and options of each group of a training, those of the policy left out."""
    common = [_row(f'--{name}', *about) for name, about in COMMON.items()]
    parts = list(_parts(run, '', '--'))
    yield 'Run', common + parts[0][1]
    for path, rows in parts[1:]:
        name = path.rpartition('.')[2]
        yield _TITLES.get(name, name), rows


def policy_groups(policy: Config) -> Iterator[tuple[str, list[OptionRow]]]:
    """Yield title and options of each group of a policy."""
    yield from _parts(policy, _POLICY, f'--{_POLICY}.', nested=True)


def _parts(
    config: Config, path: str, prefix: str, nested: bool = False
) -> Iterator[tuple[str, list[OptionRow]]]:
    """Yield the options of a configuration, then those of its parts; nested: with their names."""
    rows, inner = [], []
    for f in fields(config):
        value = getattr(config, f.name)
        if isinstance(value, Config):
            inner.append((f.name, value))
        elif 'doc' in f.metadata:
            rows.append(_row(prefix + f.name, value, f.metadata['doc'], f.metadata))
    for name, (value, metadata) in config.added().items():
        rows.append(_row(prefix + name, value, metadata['doc']))
    yield path, rows
    for name, value in inner:
        below = f'{prefix}{name}.' if nested else prefix
        yield from _parts(value, f'{path}.{name}'.lstrip('.'), below, nested)


def _row(name: str, value: Any, doc: str, metadata: Mapping[str, Any] | None = None) -> OptionRow:
    """Return an option with its default, and its choices where the meaning does not name them."""
    choices = choices_of(metadata or {})
    if not all(choice in doc for choice in choices):
        doc = f'{doc}: {", ".join(choices)}'
    default = 'required' if value is None else 'off' if value is False else f'{value}'
    return OptionRow(name.replace('_', '-'), default.replace('()', ''), doc)


def usage(name: str) -> str:
    """Return how a training is called."""
    bags = 'BAG [BAG ...] ' if name == 'bc' else ''
    return f'shepherd train {name} {bags}--out FOLDER [options]'


def print_help(name: str, about: str, run: Config, policy: Config, whole: bool) -> None:
    """Print the help of a training; whole: with the options of the policy."""
    console = Console(highlight=False)
    console.print(Text(f'usage: {usage(name)}\n\n{about}'))
    if name == 'bc':
        console.print(Text(f'\nBAG: {BAGS}'))
    groups = list(option_groups(run))
    of_policy = list(policy_groups(policy))
    for title, rows in groups + (of_policy if whole else []):
        console.print(Text(f'\n{title}', style='bold'))
        console.print(Padding(_grid(rows), (0, 0, 0, 2)))
    if not whole:
        count = sum(len(rows) for _, rows in of_policy)
        more = f'{count} options of lidar, observation and network begin with --policy.'
        console.print(Text(f'\nPolicy: {more}'))
    console.print(Text('\n--help shows this, --help-policy all with those of the policy.'))


def _grid(rows: list[OptionRow]) -> Table:
    """Return options, defaults and meanings as columns."""
    grid = Table.grid(padding=(0, 2))
    grid.add_column(no_wrap=True)
    grid.add_column(style='cyan')
    grid.add_column()
    for row in rows:
        grid.add_row(Text(row.name), Text(row.default), Text(row.text))
    return grid
