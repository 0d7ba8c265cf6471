"""Experiments as data: those of the paper's figures, the table, and sweeps beyond the paper."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from shepherd_ros.config import unknown_name
from shepherd_ros.experiments.setting import Setting

OF_THE_PAPER = ('fig4', 'fig5', 'fractions', 'fig6', 'fig7', 'fig8')
QUICK_EPISODES = 50  # of each cell of the short forms: one batch
BASELINES = ('strombom', 'pierson')
ESCORTS = ('policy:escort', 'intercept', 'huddle', 'block', 'wedge', 'ring', 'idle')
PAPER_CONTROLLERS = ('policy', *BASELINES, 'drover')
FIGURE_4 = ('completion_time', 'shepherd_path_length', 'flock_spread', 'flock_path_length')
PROTECTED = ('clean_success', 'success')
FRACTION_METRICS = ('fraction_reached', 'shepherd_path_length')
TENS = tuple(range(10, 101, 10))
SIZES, TEAMS = (10, 20, 50, 100, 150, 200, 300, 400), (1, 2, 3, 4, 6, 8, 10, 12)


@dataclass(frozen=True)
class Experiment:
    """Settings and controllers to run, and the axes and panels of their figure."""

    name: str
    title: str
    settings: tuple[Setting, ...]
    quick: tuple[Setting, ...]  # the short form: where the statements of the paper look
    axes: tuple[str, ...]  # one field: lines; two: a map; `case`: a row for each setting
    panels: tuple[str, ...]  # metrics
    controllers: tuple[str, ...] = PAPER_CONTROLLERS
    episodes: int = 100

    def with_preset(self, preset: str) -> Experiment:
        """Return the experiment with a preset; unchanged if that is an axis or ''."""

        def moved(settings: tuple[Setting, ...]) -> tuple[Setting, ...]:
            return tuple(replace(s, preset=preset) for s in settings)

        if not preset or 'preset' in self.axes:
            return self
        return replace(self, settings=moved(self.settings), quick=moved(self.quick))

    def with_changes(self, words: tuple[str, ...]) -> Experiment:
        """Return the experiment with changes PATH=VALUE in all its settings."""

        def changed(settings: tuple[Setting, ...]) -> tuple[Setting, ...]:
            return tuple(replace(s, set=(*s.set, *words)) for s in settings)

        return replace(self, settings=changed(self.settings), quick=changed(self.quick))

    def in_tasks(self, tasks: Sequence[str]) -> Experiment:
        """Return the experiment in each of some tasks, unchanged without any."""

        def moved(settings: tuple[Setting, ...]) -> tuple[Setting, ...]:
            return tuple(dict.fromkeys(s.in_task(t, self.axes) for s in settings for t in tasks))

        if not tasks:
            return self
        return replace(self, settings=moved(self.settings), quick=moved(self.quick))


def setting_grid(base: Setting | None = None, **values: Sequence[Any]) -> tuple[Setting, ...]:
    """Return the settings of a grid, the last field fastest."""
    rows = product(*values.values())
    return tuple(replace(base or Setting(), **dict(zip(values, row, strict=True))) for row in rows)


def _sweep(
    name: str, title: str, panels: tuple[str, ...], quick: dict[str, Sequence[Any]], **axes: Any
) -> Experiment:
    """Return an experiment over a grid of fields; quick names the values of its short form."""
    options = {key: axes.pop(key) for key in ('controllers', 'episodes', 'base') if key in axes}
    base = options.pop('base', None)
    settings, quick_settings = setting_grid(base, **axes), setting_grid(base, **quick)
    return Experiment(name, title, settings, quick_settings, tuple(axes), panels, **options)


def _cases(name: str, title: str, settings: Iterable[Setting], **options: Any) -> Experiment:
    """Return an experiment over settings that have no common axis."""
    rows = tuple(settings)
    quick = options.pop('quick', None) or (rows[0], rows[-1])
    panels = ('fraction_reached', 'completion_time', 'shepherd_path_length')
    return Experiment(
        name, title, rows, quick, ('case',), options.pop('panels', panels), **options
    )


def _escorting(name: str, title: str, quick: Sequence[Any], **axis: Sequence[Any]) -> Experiment:
    """Return an experiment of payload protection along an axis; quick are its ends."""
    (field,) = axis
    options = {'base': _PAYLOAD, 'controllers': ESCORTS, 'episodes': 50}
    return _sweep(name, title, PROTECTED, {field: quick}, **options, **axis)


_FIG4 = _sweep('fig4', 'Size of the flock', FIGURE_4, {'sheep': (10, 50, 100)}, sheep=TENS)
_FIG5 = _sweep(
    'fig5', 'Number of shepherds', FIGURE_4, {'shepherds': (1, 3, 4, 6)}, shepherds=range(1, 7)
)
_PRESETS = (
    'default', 'one_second', 'scaled_third', 'strombom_ra', 'rho_a_one', 'fine_dt',
    'table_literal', 'metric_attraction',
)  # fmt: skip
_TRANSFER = (
    *setting_grid(preset=_PRESETS),
    # the presets differ for this flock in their time step only
    *setting_grid(Setting(flock='reynolds'), preset=('default', 'one_second', 'fine_dt')),
)
_CELLS = (
    *setting_grid(shepherds=(1, 2, 3, 4, 6, 8, 12)),
    *setting_grid(sheep=(10, 20, 50, 200, 400)),
    *setting_grid(shepherds=(1, 12), sheep=(10, 400)),
    Setting(shepherds=2, sheep=200),
    *setting_grid(noise=(0.4, 1.0, 1.4, 2.0)),
    *setting_grid(repulsion=(0.5, 1.0, 3.0, 4.0)),
    *setting_grid(set=tuple((f'world.goal_radius={radius}',) for radius in (3, 6, 8))),
    *setting_grid(set=tuple((f'world.goal_speed={speed}',) for speed in (0.05, 0.1, 0.2))),
    Setting(preset='third'),
)
_LIDAR = (
    Setting(),
    *setting_grid(dropout=(0.1, 0.2, 0.4, 0.6, 0.8)),
    Setting(cross_occlusion=True),
    *setting_grid(rays=(256, 128, 64, 32, 16)),
)
_PAYLOAD = Setting(task='protection', sheep=40, flock='crowd')
_PAYLOADS = (
    _PAYLOAD,
    replace(_PAYLOAD, flock='drifting'),
    *(replace(_PAYLOAD, set=(f'world.goal_radius={radius}',)) for radius in (1.5, 3.0)),
)

EXPERIMENTS: dict[str, Experiment] = {
    experiment.name: experiment
    for experiment in (
        _FIG4,
        _FIG5,
        _cases(
            'fractions',
            'Share of the flock that reaches the goal',
            dict.fromkeys((*_FIG4.settings, *_FIG5.settings)),
            quick=tuple(dict.fromkeys((*_FIG4.quick, *_FIG5.quick))),
            panels=('fraction_reached',),
        ),
        _sweep(
            'fig6',
            'Noise on observed positions',
            ('completion_time', 'shepherd_path_length'),
            {'noise': (0.0, 0.4, 0.6, 1.4, 2.0)},
            noise=tuple(k / 5 for k in range(11)),
        ),
        _sweep(
            'fig7',
            'Repulsion between sheep',
            FRACTION_METRICS,
            {'repulsion': (0.5, 1.0, 3.0, 4.0)},
            repulsion=tuple(k / 2 for k in range(1, 9)),
        ),
        _sweep(
            'fig8',
            'Reynolds flock',
            FRACTION_METRICS,
            {'sheep': (10, 50, 100)},
            base=Setting(flock='reynolds'),
            sheep=TENS,
        ),
        _sweep(
            'table',
            'Teams and flocks',
            ('completion_time', 'fraction_reached'),
            {'sheep': (100,), 'shepherds': (1, 3)},
            controllers=(*PAPER_CONTROLLERS, 'idle', 'random'),
            sheep=(10, 50, 100, 200),
            shepherds=range(1, 7),
        ),
        _sweep(
            'herdability',
            'What a team can herd',
            ('fraction_reached', 'fraction_in_goal'),
            {'sheep': (10, 100, 150), 'shepherds': (1, 6)},
            episodes=20,
            sheep=SIZES,
            shepherds=TEAMS,
        ),
        Experiment(
            'transfer',
            'Worlds that differ from that of training',
            _TRANSFER,
            (_TRANSFER[0], _TRANSFER[1], _TRANSFER[8]),
            ('preset', 'flock'),
            ('fraction_reached', 'fraction_in_goal'),
        ),
        _sweep(
            'noise_repulsion',
            'Noise and repulsion together',
            FRACTION_METRICS,
            {'noise': (0.0, 2.0), 'repulsion': (1.0, 4.0)},
            episodes=20,
            noise=(0.0, 0.4, 0.8, 1.2, 1.6, 2.0),
            repulsion=(0.5, 1.0, 2.0, 3.0, 4.0),
        ),
        _cases(
            'cells',
            'Policy and heuristics, cell by cell',
            _CELLS,
            controllers=('policy', *BASELINES),
            panels=('completion_time', 'shepherd_path_length', 'fraction_in_goal'),
        ),
        _cases('lidar', 'Faults of the lidar', _LIDAR, controllers=('policy',)),
        _cases(
            'starts',
            'Starts that the paper leaves out',
            setting_grid(start=('paper', 'scattered', 'two_groups')),
        ),
        _escorting('escorts', 'Number of escorts', (1, 6), shepherds=(1, 2, 3, 4, 6)),
        _escorting('pedestrians', 'Number of pedestrians', (10, 100), sheep=(10, 40, 70, 100)),
        _escorting('escort_noise', 'Noise on what escorts see', (0.0, 2.0), noise=(0.0, 1.0, 2.0)),
        _cases(
            'payloads',
            'Other crowds and regions',
            _PAYLOADS,
            panels=PROTECTED,
            controllers=ESCORTS,
            episodes=50,
        ),
    )
}
GROUPS = {
    'paper': OF_THE_PAPER,
    'beyond': ('herdability', 'transfer', 'noise_repulsion', 'lidar', 'starts'),
    'protection': ('escorts', 'pedestrians', 'escort_noise', 'payloads'),
    'all': tuple(EXPERIMENTS),
}


def experiments(names: Sequence[str]) -> list[Experiment]:
    """Return the experiments of these names or groups, each once; 4 is fig4; or ConfigError."""
    selected: dict[str, Experiment] = {}
    for name in names:
        full = f'fig{name}' if name.isdigit() else name
        for member in GROUPS.get(full, (full,)):
            if member not in EXPERIMENTS:
                raise unknown_name('experiment', name, [*EXPERIMENTS, *GROUPS])
            selected[member] = EXPERIMENTS[member]
    return list(selected.values())
