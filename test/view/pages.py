"""Episodes to put into pages, and how to read them back; the second way beside JavaScript's."""

from __future__ import annotations

from base64 import b64decode
import json
from pathlib import Path
import re
from typing import Any
import zlib

import numpy as np
from shepherd_ros.view.track import EpisodeTrack

FREE = 65535  # as the page says it


def wandering(steps: int, n: int, h: int) -> EpisodeTrack:
    """Return random ways of n sheep and h shepherds, the sheep around a goal that moves."""
    rng = np.random.default_rng(1)
    sheep, shepherds = (
        rng.normal(0, 5, (1, k, 2)) + rng.normal(0, 0.2, (steps, k, 2)).cumsum(axis=0)
        for k in (n, h)
    )
    goal = np.linspace([3.0, 1.0], [1.0, 2.0], steps)
    return EpisodeTrack(np.arange(steps) * 0.5, sheep, shepherds, goal, 4.0, title='wandering')


def herding(steps: int) -> EpisodeTrack:
    """Return an episode whose first sheep and last shepherd go where nobody else is."""
    free = wandering(steps, 12, 3)
    sheep, shepherds = free.sheep.copy(), free.shepherds.copy()
    sheep[:, 0] = np.linspace([-25.0, 20.0], [-25.0, -20.0], steps)
    shepherds[:, 2] = np.linspace([30.0, 20.0], [30.0, -20.0], steps)
    return EpisodeTrack(free.times, sheep, shepherds, free.goal, 4.0, title='herding')


def scans(track: EpisodeTrack, n_rays: int, free: float = 0.5) -> np.ndarray:
    """Return random ranges (T, H, 3, R) m, a share of the rays free."""
    rng = np.random.default_rng(2)
    steps, team = track.shepherds.shape[:2]
    ranges = rng.uniform(0.0, 75.0, (steps, team, 3, n_rays))
    ranges[rng.random(ranges.shape) < free] = np.inf
    return ranges.astype(np.float32)


def curves(track: EpisodeTrack) -> dict[str, np.ndarray]:
    """Return three metrics over time, (T,) each."""
    away = track.center - track.goal
    spread = np.linalg.norm(track.sheep - track.center[:, None], axis=-1)
    return {
        'fraction_in_goal': track.in_goal / track.sheep.shape[1],
        'goal_distance': np.linalg.norm(away, axis=-1),
        'flock_spread': np.sqrt((spread**2).mean(axis=1)),
    }


def record_of(path: Path) -> dict[str, Any]:
    """Return the data in a page."""
    text = path.read_text(encoding='utf-8')
    (found,) = re.findall(r'<script id="record" type="application/json">(.*?)</script>', text)
    return json.loads(found)


def unpacked(pack: dict[str, Any]) -> np.ndarray:
    """Return the numbers of packed data."""
    data = zlib.decompress(b64decode(pack['data']))
    values = np.frombuffer(data, np.dtype(pack['type']).newbyteorder('<')).reshape(pack['shape'])
    if 'step' not in pack:
        return values
    metres = pack['low'] + pack['step'] * values
    return np.where(values == FREE, np.inf, metres)
