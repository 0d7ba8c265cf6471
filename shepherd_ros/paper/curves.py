"""Training curves (figure 3): return over samples, and whether they rise and flatten."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import json
from pathlib import Path

import numpy as np
from shepherd_ros.config import ConfigError
from shepherd_ros.experiments.bootstrap import Array
from shepherd_ros.paper.claims import AGREES, DISAGREES, UNDECIDED

PAPER_SAMPLES = 100e6
STEPS_PER_EPISODE = 1000  # steps of the paper's episodes, by which a mean reward becomes a return
END_SHARE = 0.2  # share of the samples in which a curve has to be flat
FLAT_RISE = 0.05  # it is flat if it rises there by less than this share of its whole rise
MIN_POINTS = 10  # points of a curve that can be judged
MIN_SAMPLES = 10e6  # samples after which a curve that was ended early may count as flat
SMOOTHING_WINDOW = 100e3  # samples over which a training's rewards are averaged for the eye


@dataclass(frozen=True)
class Curve:
    """The progress of one training."""

    name: str  # of the policy, and after a dot of what sets the training apart, such as a seed
    samples: Array  # (K,) transitions of a shepherd
    returns: Array  # (K,)
    judged: bool  # True: of whole evaluation episodes; False: mean reward x 1000 steps

    @property
    def policy(self) -> str:
        """Return the name up to a dot, which trainings of one policy share."""
        return self.name.partition('.')[0]


def read_curve(path: Path) -> Curve:
    """Return the curve of a file or of the folder of a run, or raise ConfigError."""
    file = path / 'curve.jsonl' if path.is_dir() else path
    try:
        lines = file.read_text(encoding='utf-8').splitlines()
        rows = [json.loads(line) for line in lines if line.strip()]
    except (OSError, ValueError) as error:
        raise ConfigError(f'{file} is no curve of a training ({error})') from error
    if not rows or not all(isinstance(row, dict) and 'samples' in row for row in rows):
        raise ConfigError(f'{file} is no curve of a training: expected lines with samples')
    judged = any('eval/return' in row for row in rows)
    field, scale = ('eval/return', 1) if judged else ('reward', STEPS_PER_EPISODE)
    points = [(row['samples'], scale * row[field]) for row in rows if field in row]
    values = np.array(points, np.float64).reshape(-1, 2)
    name = path.name if path.is_dir() else path.stem
    return Curve(name, values[:, 0], values[:, 1], judged)


def find_curves(paths: Sequence[Path]) -> list[Curve]:
    """Return the curves of files, runs, and folders of either; ConfigError if one is missing."""
    runs: list[Path] = []
    for path in paths:
        if not path.exists():
            raise ConfigError(f'--curves is {path}: expected a curve, a run, or a folder of them')
        if path.is_file() or (path / 'curve.jsonl').exists():
            runs.append(path)
            continue
        runs += sorted(path.glob('*.jsonl'))
        runs += sorted(run.parent for run in path.glob('*/curve.jsonl'))
    return [curve for curve in map(read_curve, runs) if len(curve.samples)]


def smoothed(curve: Curve, window: float = SMOOTHING_WINDOW) -> Array:
    """Return the mean of the returns at most half a window of samples away, at each point."""
    total = np.concatenate([[0.0], curve.returns.cumsum()])
    low = np.searchsorted(curve.samples, curve.samples - window / 2, side='left')
    high = np.searchsorted(curve.samples, curve.samples + window / 2, side='right')
    return np.asarray((total[high] - total[low]) / (high - low))


def rise_and_end(curve: Curve) -> tuple[float, float]:
    """Return the rise of the return, and the share of it in the last fifth."""
    last = curve.samples[-1]
    late = curve.samples >= (1 - END_SHARE) * last
    tenth = max(len(curve.samples) // 10, 1)
    rise = float(curve.returns[-tenth:].mean() - curve.returns[:tenth].mean())
    if late.sum() < 2 or rise == 0:
        return rise, float('nan')
    slope = float(np.polyfit(curve.samples[late], curve.returns[late], 1)[0])
    return rise, slope * END_SHARE * float(last) / rise


def curve_verdict(curve: Curve) -> tuple[str, str]:
    """
    Return verdict and reason on: the curve rises and flattens within 100 million samples.

    One that ended before that and still rises is undecided, and so is a flat one of less than
    MIN_SAMPLES samples.
    """
    if len(curve.samples) < MIN_POINTS:
        return UNDECIDED, f'only {len(curve.samples)} points'
    rise, end = rise_and_end(curve)
    text = f'rises by {rise:.3g}, {100 * end:.0f} % of it in the last fifth'
    if rise <= 0:
        return DISAGREES, 'does not rise'
    flat, last = abs(end) < FLAT_RISE, curve.samples[-1]
    if (flat and last < MIN_SAMPLES) or (not flat and last < PAPER_SAMPLES):
        return UNDECIDED, f'{text}; ended at {last / 1e6:.3g} million samples'
    return (AGREES if flat else DISAGREES), text
