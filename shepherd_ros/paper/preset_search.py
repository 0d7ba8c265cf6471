"""
Search for the choices, which the paper leaves open, that agree with most of its statements.

Only the baselines drive, over the points of each figure that its statements name: a statement
about them costs seconds to check, one about a learned policy a training. Most candidates are the
best so far with one choice changed, some are drawn at random; the default preset is the first.
What is found looks better on the seeds it was found on: it is reported on others.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
import json
import math
from pathlib import Path
import random
from typing import Any

import pyarrow as pa  # type: ignore[import-untyped]
from shepherd_ros.config import ConfigError
from shepherd_ros.experiments.catalog import BASELINES, Experiment, EXPERIMENTS, OF_THE_PAPER
from shepherd_ros.experiments.cells import Cell, run_cell
from shepherd_ros.experiments.results import Results
from shepherd_ros.experiments.samples import samples_of
from shepherd_ros.experiments.setting import canonical_setting
from shepherd_ros.paper.claims import (
    AGREES,
    ClauseFinding,
    DISAGREES,
    finding_of,
    Sweep,
    UNDECIDED,
)
from shepherd_ros.paper.statements import CLAIMS
from shepherd_ros.sim.presets import Preset, PRESETS

CANDIDATE_NAME = 'candidate'  # of the preset while it is tried
# option -> values; the first is that of the default preset
CHOICES: dict[str, tuple[Any, ...]] = {
    'dt': (0.5, 0.1, 0.15, 0.2, 0.3),
    'flock.strombom.sheep_range': (1.0, 2 / 3, 4 / 3, 2.0),
    'flock.strombom.normalize_shepherds': (False, True),
    'flock.reynolds.max_acceleration': (1 / 3, 1.0, 3.0),
    'controllers.strombom.position_law': ('strombom', 'elfiqi'),
    'controllers.strombom.interaction_range': (0.0, 2 / 3, 4 / 3, 2.0),
    'controllers.strombom.standoff': (4.0, 6.0, 8.0),
    'controllers.strombom.arc': ('farthest', 'rms'),
    'controllers.strombom.arc_margin': (0.0, 1.5, 2.0, 6.0, 7.0, 9.0, 10.0, 22.0),
    'controllers.strombom.stop_range': (3.0, 0.0, 1.5, 4.0, 4.5, 5.0, 6.0),
    'controllers.strombom.stop_distance': (0.0, 4.0, 6.0, 8.0),
    'controllers.strombom.wing_spacing': (0.0, 0.2, 0.4),
    'controllers.pierson.pace': ('tracking', 'constant'),
    'controllers.pierson.lead': (2.0, 1.0, 4.0),
    'controllers.pierson.gain': (0.05, 0.1, 0.2),
    'controllers.pierson.min_radius': (4.0, 2.0, 8.0),
    'controllers.pierson.spread_factor': (3.0, 2.0, 5.0),
    'controllers.pierson.weakest_push': (0.15, 0.05, 0.4),
    'controllers.pierson.tracking_gain': (0.0, 0.5, 1.0),
}
NEAR_MISS_WORTH = 0.4  # score of a number next to its bounds
SHARE_NEW = 0.1  # of candidates that are drawn anew
SEARCH_SEED, REPORT_SEED = 0, 1000  # of the first episode, where it is searched and reported

Candidate = dict[str, Any]
KnownTables = dict[str, pa.Table]  # rows of cells by their configuration


@dataclass(frozen=True)
class Tried:
    """A candidate with the verdicts on the clauses about the baselines alone."""

    candidate: Candidate
    verdicts: dict[str, str]  # by statement and number
    numbers: dict[str, float]  # the same
    gaps: dict[str, float]  # from a number to its bounds, over the bound; 0 within them

    @property
    def score(self) -> float:
        """Return the score of the verdicts."""
        return score_of(self.verdicts.values())

    @property
    def merit(self) -> float:
        """Return the score, plus up to NEAR_MISS_WORTH for numbers close to their bounds."""
        wrong = (gap for key, gap in self.gaps.items() if self.verdicts[key] == DISAGREES)
        return self.score + sum(NEAR_MISS_WORTH / (1 + gap) for gap in wrong)


def gap_of(value: float, low: float, high: float) -> float:
    """Return the gap of a number to its bounds, over the nearer one; inf for NaN."""
    if math.isnan(value):
        return math.inf
    bound = min(max(value, low), high)
    return abs(value - bound) / max(abs(bound), 1e-9)


def preset_of(candidate: Candidate) -> Preset:
    """Return a candidate as a preset."""
    parts: dict[str, dict[str, dict[str, Any]]] = {'flock': {}, 'controllers': {}}
    for path, value in candidate.items():
        if path != 'dt':
            kind, name, option = path.split('.')
            parts[kind].setdefault(name, {})[option] = value
    return Preset(CANDIDATE_NAME, 'under trial', candidate['dt'], **parts)


def short_experiment(name: str) -> Experiment:
    """Return an experiment in its short form, in the candidate's preset."""
    whole = EXPERIMENTS[name].with_preset(CANDIDATE_NAME)
    return replace(whole, settings=whole.quick)


def findings(
    preset: Preset,
    episodes: int,
    steps: int = 1000,
    known: KnownTables | None = None,
    first: int = SEARCH_SEED,
) -> dict[str, ClauseFinding]:
    """
    Run the baselines in a preset; return the findings on clauses about them alone, by text.

    first is the seed of the first episode.
    Cells in known are not run again; those that are run are added to it.
    """
    PRESETS.add(replace(preset, name=CANDIDATE_NAME))
    known = {} if known is None else known
    try:
        experiments = {name: short_experiment(name) for name in OF_THE_PAPER}
        settings = dict.fromkeys(
            canonical_setting(s) for e in experiments.values() for s in e.settings
        )
        tables = []
        for setting in settings:
            for name in BASELINES:
                cell = Cell(replace(setting, steps=steps), name, first, episodes)
                key = json.dumps([cell.config(), first])  # without the name of the preset
                if key not in known:
                    known[key] = run_cell(cell)
                tables.append(known[key])
        rows = Results(pa.concat_tables(tables))
        result = {}
        for claim in CLAIMS:
            samples = samples_of(rows, experiments[claim.experiment])
            assert samples is not None, 'all of an experiment was run'
            for clause in claim.clauses:
                finding = finding_of(clause, Sweep(samples, ''))
                if not finding.reason:  # else it needs a policy
                    result[f'{claim.experiment}: {claim.statement}: {clause.text}'] = finding
        return result
    finally:
        PRESETS.remove(CANDIDATE_NAME)


def score_of(verdicts: Iterable[str]) -> float:
    """Return the number of verdicts that agree; an undecided one counts half."""
    return sum({AGREES: 1.0, UNDECIDED: 0.5}.get(verdict, 0.0) for verdict in verdicts)


def attempt(
    candidate: Candidate, episodes: int, steps: int = 1000, known: KnownTables | None = None
) -> Tried:
    """Return a candidate with its verdicts; known as in findings()."""
    result = findings(preset_of(candidate), episodes, steps, known)
    return Tried(
        candidate,
        {key: f.strict for key, f in result.items()},
        {key: f.value for key, f in result.items()},
        {key: gap_of(f.value, f.clause.low, f.clause.high) for key, f in result.items()},
    )


def proposals(seed: int, known: list[Tried]) -> Iterator[Candidate]:
    """Yield candidates without end, none twice; the caller appends results to known."""
    draw = random.Random(seed)
    proposed: list[Candidate] = []
    while True:
        if not proposed:
            candidate = {path: values[0] for path, values in CHOICES.items()}
        elif draw.random() < SHARE_NEW:
            candidate = {path: draw.choice(values) for path, values in CHOICES.items()}
        else:
            best = max(reversed(known), key=lambda tried: tried.merit).candidate  # the latest
            path = draw.choice(list(CHOICES))
            candidate = best | {path: draw.choice(CHOICES[path])}
        if candidate not in proposed:
            proposed.append(candidate)
            yield candidate


def read_tried(path: Path) -> list[Tried]:
    """Return the candidates of a file, [] without the file; or raise ConfigError."""
    if not path.exists():
        return []
    candidates = []
    for number, line in enumerate(path.read_bytes().splitlines(), start=1):
        try:
            candidates.append(Tried(**json.loads(line)))
        except (TypeError, ValueError) as error:
            raise ConfigError(
                f'line {number} of {path} is no candidate that this version has tried: remove '
                'that line and those after it, or give another --out'
            ) from error
    return candidates


def search(path: Path, seed: int, count: int, episodes: int, steps: int = 1000) -> Iterator[Tried]:
    """
    Try candidates until the file holds `count`; yield each, those in the file too.

    Raises ConfigError if the file is of another search.
    """
    old = read_tried(path)
    known: list[Tried] = []
    cells: KnownTables = {}
    source = proposals(seed, known)
    path.parent.mkdir(parents=True, exist_ok=True)
    while len(known) < count:
        candidate = next(source)
        if len(known) < len(old):
            tried = old[len(known)]
            if tried.candidate != candidate:
                raise ConfigError(
                    f'line {len(known) + 1} of {path} is not what this search tries: it is of '
                    'another --seed or version; give another --out'
                )
        else:
            tried = attempt(candidate, episodes, steps, cells)
            with path.open('a', encoding='utf-8') as file:
                file.write(json.dumps(asdict(tried)) + '\n')
        known.append(tried)
        yield tried
