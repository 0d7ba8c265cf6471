"""Report on recordings that a policy learns from, counted while they are read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from shepherd_ros.config import ConfigError
from shepherd_ros.datasets.running_stats import RunningStats
from shepherd_ros.datasets.steps import Steps
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS

_COUNTS = ('bags', 'episodes', 'partial_episodes', 'steps', 'examples')


@dataclass
class Report:
    """Counts of bags, episodes, steps of single shepherds, and examples."""

    bags: int = 0
    episodes: int = 0
    partial_episodes: int = 0  # of them, those of which states were not recorded
    steps: int = 0
    examples: int = 0
    drops: Counter[str] = field(default_factory=Counter)  # reason -> steps
    first_drop: dict[str, str] = field(default_factory=dict)  # reason -> where
    sheep: Counter[int] = field(default_factory=Counter)  # flock -> episodes
    shepherds: Counter[int] = field(default_factory=Counter)  # team -> episodes
    speed: RunningStats = field(default_factory=lambda: RunningStats(1))  # m/s, of whole steps
    drivers: Counter[str] = field(default_factory=Counter)  # source of mux -> whole steps
    channels: tuple[str, ...] = PAPER_CHANNELS
    returns: RunningStats = field(
        default_factory=lambda: RunningStats(len(PAPER_CHANNELS))
    )  # share of rays
    on_bag: Callable[[int, int], None] = lambda done, total: None  # before each bag of so many

    def drop(self, reason: str, where: str, count: int = 1) -> None:
        """Count steps that are dropped as examples, with the reason and the first place."""
        self.drops[reason] += count
        self.first_drop.setdefault(reason, where)

    def refuse(self, reason: str, where: str, count: int = 1) -> None:
        """Count steps that are incomplete, with the reason and the first place."""
        self.steps += count
        self.drop(reason, where, count)

    def count_episode(self, steps: Steps) -> None:
        """Count an episode and its complete steps."""
        self.episodes += 1
        self.partial_episodes += steps.partial
        self.steps += len(steps)
        self.sheep[steps.n_sheep] += 1
        self.shepherds[steps.n_shepherds] += 1
        self.drivers.update(str(name) for name in steps.driver)
        self.speed.add(np.linalg.norm(steps.action.astype(np.float64), axis=1)[:, None])
        if steps.channels != self.channels:
            if self.returns.count.any():
                raise ConfigError(
                    f'{steps.where}: scans have channels {", ".join(steps.channels)}, expected '
                    f'{", ".join(self.channels)} as in the bags before; take bags of one kind'
                )
            self.channels, self.returns = steps.channels, RunningStats(len(steps.channels))
        if len(steps):
            self.returns.add(np.isfinite(steps.lidar).mean(axis=2))

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain data."""
        shares = self.returns.to_dict()
        return {
            **{name: getattr(self, name) for name in _COUNTS},
            'dropped': [
                {'reason': reason, 'steps': count, 'first': self.first_drop[reason]}
                for reason, count in self.drops.most_common()
            ],
            'speed': {name: values[0] for name, values in self.speed.to_dict().items()},
            'returns': {
                channel: {name: values[k] for name, values in shares.items()}
                for k, channel in enumerate(self.channels)
            },
            **({'steps_by_driver': dict(sorted(self.drivers.items()))} if self.drivers else {}),
            'episodes_by_shepherds': dict(sorted(self.shepherds.items())),
            'episodes_by_sheep': dict(sorted(self.sheep.items())),
        }

    def text(self) -> str:
        """Return the report in lines for a terminal."""
        data = self.to_dict()
        part = f' ({self.partial_episodes} not whole)' if self.partial_episodes else ''
        lines = [f'bags:      {self.bags}', f'episodes:  {self.episodes}{part}']
        lines += [f'steps:     {self.steps} (of single shepherds)', f'examples:  {self.examples}']
        for row in data['dropped']:
            lines.append(
                f'dropped:   {row["steps"]} steps, {row["reason"]}; first: {row["first"]}'
            )
        for name, count in sorted(self.drivers.items()):
            lines.append(f'driven:    {count} steps by {name or "none: zero"}')
        columns = ('mean', 'std', 'min', 'max')
        lines += ['', ' ' * 24 + ''.join(f'{name:>8}' for name in columns)]
        rows = [('speed [m/s]', data['speed'])]
        rows += [(f'rays that hit, {name}', row) for name, row in data['returns'].items()]
        for name, row in rows:
            lines.append(f'{name:<24}' + ''.join(f'{row[column]:8.3f}' for column in columns))
        for name in ('shepherds', 'sheep'):
            lines += ['', f'{name:>9}  episodes']
            lines += _bars(data[f'episodes_by_{name}'])
        return '\n'.join(lines)


def _bars(counts: dict[int, int], max_bars: int = 12, width: int = 40) -> list[str]:
    """Return the lines of a histogram of at most max_bars bars."""
    low, high = min(counts, default=0), max(counts, default=0)
    bar_width = -(-(high - low + 1) // max_bars)
    bars: Counter[int] = Counter()
    for value, count in counts.items():
        bars[(value - low) // bar_width] += count
    longest = max(bars.values(), default=1)
    lines = []
    for k, count in sorted(bars.items()):
        first = low + k * bar_width
        last = min(first + bar_width - 1, high)
        name = f'{first}' if first == last else f'{first}-{last}'
        lines.append(f'{name:>9}  {count:>8}  {"#" * -(-width * count // longest)}')
    return lines
