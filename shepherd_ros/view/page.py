"""An episode as one HTML file that replays it in a browser, without any network."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
import html
import json
import math
from pathlib import Path
from string import Template
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shepherd_ros.config import ConfigError
from shepherd_ros.sim.lidar_layout import channel_of
from shepherd_ros.view.animation import TRAIL
from shepherd_ros.view.look import beside, DRAWING, STYLES
from shepherd_ros.view.packing import packed, quantum, rounded
from shepherd_ros.view.scene import view_limits
from shepherd_ros.view.track import EpisodeTrack

_Ranges = NDArray[np.float32]

MOST_STEPS = 20_000  # in a page; of a longer episode fewer are shown
MOST_PLACES = 3_000_000  # coordinates in a page, steps x bodies x 2
MOST_RANGES = 32_000_000  # numbers of rays in a page
MOST_BYTES = 8_000_000  # of text for the rays


@dataclass(frozen=True)
class Lidar:
    """The rays that a page shows."""

    shepherds: list[int]  # S, one for each lidar
    ranges: _Ranges  # (T, S, C, R) m, +inf on free rays
    channels: tuple[str, ...]


def write_page(
    track: EpisodeTrack,
    metrics: Mapping[str, ArrayLike],
    path: Path | str,
    *,
    units: Mapping[str, str] = MappingProxyType({}),
    ranges: ArrayLike | None = None,
    title: str | None = None,
) -> None:
    """
    Write an episode as .html: a plane to play, pause and scrub, and curves of metrics.

    metrics are (T,) each, NaN where there is no value; units are theirs by name. ranges (T, H, C,
    R) m are those of all shepherds, +inf on free rays; without them the page shows those of the
    track, if it has any.
    A file of more than about 10 MB is avoided: of long episodes and large teams the page has
    every so many steps and rays only, and says so. title is by default that of the track.
    """
    path = Path(path)
    if path.suffix.lower() not in ('.html', '.htm'):
        raise ConfigError(f'{path} ends in {path.suffix!r}: expected .html')
    if not path.parent.is_dir():
        raise ConfigError(f'{path}: the folder {path.parent} is not there; make it first')
    record = page_record(track, metrics, units, ranges)
    heading = track.title if title is None else title
    parts = {
        'title': html.escape(heading or 'Shepherding episode'),
        'facts': html.escape(facts(track)),
        'notes': html.escape(' '.join(record.pop('notes'))),
        'style': beside(*STYLES, 'page.css'),
        'scripts': beside(*DRAWING, 'record.js', 'page.js'),
        **dict(zip(('many', 'one', 'disc'), map(html.escape, track.words), strict=True)),
        'record': json.dumps(record, allow_nan=False).replace('<', r'\u003c'),
    }
    path.write_text(Template(beside('page.html')).substitute(parts), encoding='utf-8')


def facts(track: EpisodeTrack) -> str:
    """Return the line under the title."""
    (steps, n_sheep), team = track.sheep.shape[:2], track.shepherds.shape[1]
    many, one, _ = track.words
    return (
        f'{n_sheep} {many}, {team} {one}{"s" * (team != 1)}, {steps - 1} '
        f'step{"s" * (steps != 2)}, {track.times[-1] - track.times[0]:.5g} s'
    )


def page_record(
    track: EpisodeTrack,
    metrics: Mapping[str, ArrayLike],
    units: Mapping[str, str],
    ranges: ArrayLike | None = None,
) -> dict[str, Any]:
    """Return the content of a page, as plain data for JSON; notes name the parts left out."""
    if not (np.diff(track.times) > 0).all():
        late = int((np.diff(track.times) <= 0).argmax()) + 1
        raise ConfigError(
            f'times[{late}] is {track.times[late]} after {track.times[late - 1]}: expected '
            'times that increase; leave out steps that are there twice'
        )
    curves = {name: curve(name, values, len(track.times)) for name, values in metrics.items()}
    lidar = seen(track, ranges)
    drawn = [channel_of(name) for name in track.channels]
    steps, every = kept_steps(len(track.times), track.sheep.shape[1] + track.shepherds.shape[1])
    notes = [f'1 in {every} steps is shown.'] if every > 1 else []
    places = np.concatenate([track.sheep, track.shepherds], axis=1)[steps]
    low, high = float(places.min()), float(places.max())
    unit = quantum(high - low)
    notes.append(f'Positions are rounded to {unit:g} m.')
    record: dict[str, Any] = {
        'times': packed(track.times[steps]),
        'steps': packed(steps),
        'sheep': rounded(track.sheep[steps], low, unit),
        'shepherds': rounded(track.shepherds[steps], low, unit),
        'goal': packed(track.goal[steps]),
        'goalRadius': track.goal_radius,
        'words': track.words,
        'inGoal': packed(track.in_goal[steps].astype(np.int32)),
        'limits': view_limits(track),
        'curves': [
            {'name': name.replace('_', ' '), 'unit': units.get(name, '')} | packed(values[steps])
            for name, values in curves.items()
        ],
        'colors': {'rays': [c.color for c in drawn], 'hits': [c.hit for c in drawn]},
        'trail': TRAIL,
        'lidar': None,
    }
    if lidar is not None:
        record['lidar'], note = rays(replace(lidar, ranges=lidar.ranges[steps]))
        notes.append(note)
    return record | {'notes': notes}


def kept_steps(steps: int, bodies: int) -> tuple[NDArray[np.int32], int]:
    """Return the steps that a page shows, the last among them, and how far apart they are."""
    every = math.ceil(max(steps / MOST_STEPS, steps * bodies * 2 / MOST_PLACES))
    return np.union1d(np.arange(0, steps, every), steps - 1).astype(np.int32), every


def curve(name: str, values: ArrayLike, steps: int) -> NDArray[np.float32]:
    """Return the values of a metric, (T,), or raise ConfigError."""
    numbers = np.asarray(values, dtype=np.float32)
    if numbers.shape != (steps,):
        raise ConfigError(
            f'metrics[{name!r}] has shape {numbers.shape}: expected ({steps},), a value for each '
            "of the track's times"
        )
    if np.isinf(numbers).any():
        step = int(np.isinf(numbers).argmax())
        raise ConfigError(
            f'metrics[{name!r}] is {numbers[step]} at step {step}: expected finite numbers; put '
            'NaN where there is no value'
        )
    return numbers


def seen(track: EpisodeTrack, ranges: ArrayLike | None) -> Lidar | None:
    """Return the lidar to show: of all shepherds, or that of the track; raises ConfigError."""
    steps, team = track.shepherds.shape[:2]
    if ranges is not None:
        shepherds = list(range(team))
        values = np.asarray(ranges, dtype=np.float32)
    elif track.ranges is not None:
        shepherds = [track.lidar_shepherd]
        values = track.ranges[:, None].astype(np.float32)
    else:
        return None
    count = len(track.channels)
    if values.ndim != 4 or values.shape[:3] != (steps, len(shepherds), count) or not values.size:
        raise ConfigError(
            f'ranges has shape {values.shape}: expected ({steps}, {team}, {count}, any), not '
            'empty: times, shepherds, channels, rays'
        )
    wrong = ~(values >= 0)  # NaN too
    if wrong.any():
        raise ConfigError(
            f'ranges has {wrong.sum()} numbers such as {values[wrong][0]}: expected metres of at '
            'least 0; put +inf on free rays'
        )
    return Lidar(shepherds, values, track.channels)


def rays(lidar: Lidar) -> tuple[dict[str, Any], str]:
    """Return the rays as plain data of at most MOST_BYTES, and a note on them."""
    n_rays = lidar.ranges.shape[-1]
    every = min(n_rays, math.ceil(lidar.ranges.size / MOST_RANGES))
    finite = lidar.ranges[np.isfinite(lidar.ranges)]
    step = quantum(float(finite.max())) if finite.size else quantum(0)
    while True:
        data = rounded(lidar.ranges[..., ::every], 0.0, step)
        size = len(data['data'])
        if size <= MOST_BYTES or every == n_rays:
            break
        every = min(n_rays, max(every + 1, math.ceil(every * size / MOST_BYTES)))
    shown = f'1 in {every} of the {n_rays}' if every > 1 else f'all {n_rays}'
    note = f'Lidar: {shown} rays are shown, ranges are rounded to {step:g} m.'
    pitch = 2 * math.pi * every / n_rays
    return data | {'of': lidar.shepherds, 'names': lidar.channels, 'pitch': pitch}, note
