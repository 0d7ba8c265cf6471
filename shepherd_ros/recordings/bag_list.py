"""Summary of the bags in a folder: a line for each, their totals and means of their metrics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from shepherd_ros.recordings.info import bag_info, BagInfo, size_text
from shepherd_ros.rosbag2.bag import Bag
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.rosbag2.reader import open_bag

MAX_SEEDS = 3  # that a line names
HEAD = ('Bag', 'Duration [s]', 'Messages', 'Size', 'Episodes', 'Seeds', '')


@dataclass
class BagList:
    """The bags of a folder by name, and those that cannot be read with the reason."""

    bags: dict[str, BagInfo] = field(default_factory=dict)
    unreadable: dict[str, str] = field(default_factory=dict)

    def text(self) -> str:
        """Return a table of the bags, then totals and means over all whole episodes."""
        rows = [HEAD, *(_row(name, info) for name, info in sorted(self.bags.items()))]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = [
            '  '.join(
                text.ljust(width) if k in (0, 5, 6) else text.rjust(width)
                for k, (text, width) in enumerate(zip(row, widths, strict=True))
            ).rstrip()
            for row in rows
        ]
        lines += [f'{name}  {reason}' for name, reason in sorted(self.unreadable.items())]
        return '\n'.join([*lines, '', *self._totals()])

    def content(self) -> dict[str, Any]:
        """Return the same as plain data for JSON, without totals."""
        bags = {name: info.content() for name, info in sorted(self.bags.items())}
        return {'bags': bags, 'unreadable': self.unreadable}

    def _totals(self) -> list[str]:
        """Return the lines below the table."""
        infos = list(self.bags.values())
        episodes = [episode for info in infos for episode in info.episodes]
        whole = sum(episode.whole for episode in episodes)
        lines = [
            f'{_count(len(infos), "bag")}, {_count(len(episodes), "episode")}, {whole} whole; '
            f'{sum(info.messages for info in infos)} messages, '
            f'{size_text(sum(info.size for info in infos))}, '
            f'{sum(info.duration_ns for info in infos) / 1e9:.1f} s'
        ]
        if self.unreadable:
            lines.append(f'{_count(len(self.unreadable), "bag")} cannot be read')
        tasks = {info.task for info in infos if info.whole_values}
        values = [values for info in infos for values in info.whole_values]
        if len(tasks) == 1:
            from shepherd_ros.recordings.episode_metrics import mean_texts  # needs torch

            first = next(info for info in infos if info.metrics)
            heads, task = first.metrics, first.task
            lines += ['', f'Mean over {_count(len(values), "whole episode")}:']
            wide = max(map(len, heads))
            pairs = zip(heads, mean_texts(values, task), strict=True)
            lines += [f'  {head:<{wide}}  {text}' for head, text in pairs]
        return lines


def list_bags(
    folders: Sequence[Path],
    metrics: bool = False,
    on_bag: Callable[[int, Bag], None] = lambda done, bag: None,
) -> BagList:
    """Return what is in bags; on_bag(how many are done, bag) is called before each is read."""
    rows = BagList()
    for done, folder in enumerate(folders):
        try:
            bag = open_bag(folder)
            on_bag(done, bag)
            rows.bags[folder.name] = bag_info(bag, metrics)
        except BagError as error:
            rows.unreadable[folder.name] = str(error)
    return rows


def _row(name: str, info: BagInfo) -> tuple[str, ...]:
    """Return the line of a bag."""
    seeds = [str(episode.seed) for episode in info.episodes]
    named = ', '.join([*seeds[:MAX_SEEDS], *(['...'] if len(seeds) > MAX_SEEDS else [])])
    partial = sum(not episode.whole for episode in info.episodes)
    return (
        name,
        f'{info.duration_ns / 1e9:.1f}',
        str(info.messages),
        size_text(info.size),
        str(len(seeds)),
        named,
        f'{partial} not whole' if partial else '',
    )


def _count(number: int, what: str) -> str:
    """Return a number and what is counted."""
    return f'{number} {what}{"" if number == 1 else "s"}'
