"""Samples of one experiment: its episodes among many rows, in the order of its settings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from shepherd_ros.config import ConfigError
from shepherd_ros.experiments.bootstrap import Array
from shepherd_ros.experiments.catalog import Experiment
from shepherd_ros.experiments.methods import sorted_methods
from shepherd_ros.experiments.results import Results, value_names
from shepherd_ros.experiments.setting import (
    canonical_setting,
    describe_setting,
    env_config,
    Setting,
)

FLOOR_METHODS = ('idle', 'random')


@dataclass(frozen=True)
class Samples:
    """Metrics of episodes by controller and setting; the same seeds in all."""

    experiment: Experiment
    settings: tuple[Setting, ...]  # those with rows, P of them
    seeds: tuple[int, ...]  # that all cells have, E of them
    steps: int
    values: dict[tuple[str, str], Array] = field(repr=False)  # controller, metric -> (P, E)
    left_out: tuple[str, ...] = ()  # controllers with too few episodes

    @property
    def controllers(self) -> list[str]:
        """Return the names of the controllers, in the order of pictures."""
        return sorted_methods(list({name for name, _ in self.values}))

    @property
    def policies(self) -> list[str]:
        """Return the names of the learned controllers."""
        return [name for name in self.controllers if name.startswith('policy:')]

    @property
    def notes(self) -> list[str]:
        """Return a line for each controller with too few episodes."""
        text = f'{self.experiment.name} is without {{}}: too few of its episodes are there'
        return [text.format(name) for name in self.left_out]

    def axis(self, name: str) -> list[Any]:
        """Return the values of a field of the settings; for `case`, their descriptions."""
        return [describe_setting(s) if name == 'case' else getattr(s, name) for s in self.settings]


def samples_of(
    rows: Results, experiment: Experiment, least: int = 1, whole: bool = False
) -> Samples | None:
    """
    Return the episodes of an experiment, or raise ConfigError if they do not fit together.

    None: rows of fewer than `least` of its settings. A controller that lacks a setting has NaN
    there; one with less than half of the episodes of another (as many from each of its cells), one
    with other seeds, and with `whole` one that lacks any, is left out, and named.
    """
    cells: dict[tuple[str, int], np.ndarray] = {}  # controller, setting -> indices of rows
    settings = list(dict.fromkeys(map(canonical_setting, experiment.settings)))
    for place, setting in enumerate(settings):
        # two settings can be the same world: a preset, and what it changes
        mask = rows.in_environment(env_config(setting))
        for name in sorted(set(rows.columns['controller'][mask].tolist())):
            if name in FLOOR_METHODS and name not in experiment.controllers:
                continue  # rows of the table, which would clutter a figure
            cells[name, place] = np.flatnonzero(mask & rows.where(controller=name))
    sizes: dict[str, list[int]] = {}  # controller -> episodes in each of its cells
    for (name, _), index in cells.items():
        sizes.setdefault(name, []).append(len(index))
    count = {name: len(episodes) * min(episodes) for name, episodes in sizes.items()}
    largest = max(count.values(), default=0)
    cells = {key: index for key, index in cells.items() if 2 * count[key[0]] >= largest}
    cells = _of_same_seeds(cells, rows, count)
    if whole:
        cells = _of_whole(cells, rows, experiment, settings)
    if len({place for _, place in cells}) < least:
        return None
    steps = _common(rows, cells, experiment.name)
    seeds = sorted(
        set.intersection(*(set(rows.columns['seed'][index].tolist()) for index in cells.values()))
    )
    if not seeds:
        raise ConfigError(f'{experiment.name}: no seed is in all its cells; evaluate it again')
    present = sorted({place for _, place in cells})
    values = {
        (name, metric): np.full((len(present), len(seeds)), np.nan)
        for name in {name for name, _ in cells}
        for metric in value_names()
    }
    for (name, place), index in cells.items():
        chosen = index[np.isin(rows.columns['seed'][index], seeds)]
        chosen = chosen[np.argsort(rows.columns['seed'][chosen])]
        for metric in value_names():
            values[name, metric][present.index(place)] = rows.columns[metric][chosen]
    left_out = tuple(sorted_methods(list(count.keys() - {name for name, _ in cells})))
    present_settings = tuple(settings[p] for p in present)
    return Samples(experiment, present_settings, tuple(seeds), steps, values, left_out)


def _of_same_seeds(
    cells: dict[tuple[str, int], Array], rows: Results, count: dict[str, int]
) -> dict[tuple[str, int], Array]:
    """Return the cells of the controllers that share seeds with the one of most episodes."""
    seeds: dict[str, set[int]] = {}  # that all cells of a controller have
    for (name, _), index in cells.items():
        own = set(rows.columns['seed'][index].tolist())
        seeds[name] = seeds.get(name, own) & own
    most = seeds[max(seeds, key=lambda name: count[name])] if seeds else set()
    return {key: index for key, index in cells.items() if not most or seeds[key[0]] & most}


def _of_whole(
    cells: dict[tuple[str, int], Array],
    rows: Results,
    experiment: Experiment,
    settings: list[Setting],
) -> dict[tuple[str, int], Array]:
    """
    Return the cells of the complete controllers.

    Those have all settings, or all of the short form if there are no others, with the largest
    number of common seeds.
    """
    short = [settings.index(canonical_setting(s)) for s in experiment.quick]
    present = {place for _, place in cells}
    needed = short if present <= set(short) else list(range(len(settings)))
    seeds = {
        name: set.intersection(
            *(set(rows.columns['seed'][cells.get((name, p), [])].tolist()) for p in needed)
        )
        for name in {name for name, _ in cells}
    }
    largest = max(map(len, seeds.values()), default=0)
    return {
        key: index for key, index in cells.items() if largest and len(seeds[key[0]]) == largest
    }


def _common(rows: Results, cells: dict[tuple[str, int], np.ndarray], title: str) -> int:
    """Return the steps of all episodes; ConfigError if results of two kinds are mixed."""
    rows_used = np.concatenate(list(cells.values()))
    for name in ('steps', 'version'):
        values = sorted(set(rows.columns[name][rows_used].tolist()))
        if len(values) > 1:
            raise ConfigError(
                f'{title}: rows with {name} {" and ".join(map(str, values))} are mixed: expected '
                'those of one evaluation; give fewer folders'
            )
    for name, place in cells:
        keys = sorted(set(rows.columns['key'][cells[name, place]].tolist()))
        if len(keys) > 1:
            raise ConfigError(
                f'{title}: {name} has rows of {len(keys)} configurations or checkpoints for one '
                f'setting ({", ".join(keys)}): remove those that are old'
            )
    return int(rows.columns['steps'][rows_used][0])


def means(samples: Samples, names: Sequence[str]) -> list[tuple[str, Setting, dict[str, Array]]]:
    """Return the episodes (E,) of some metrics for each controller and setting that has them."""
    cells = []
    for place, setting in enumerate(samples.settings):
        for controller in samples.controllers:
            values = {name: samples.values[controller, name][place] for name in names}
            if not np.isnan(next(iter(values.values()))).any():
                cells.append((controller, setting, values))
    return cells
