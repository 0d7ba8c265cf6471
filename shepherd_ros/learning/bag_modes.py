"""Modes of recorded steps, drive or hold, by the condition of a composite teacher."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from shepherd_ros.config import ConfigError
from shepherd_ros.datasets.steps import Steps


def holding(steps: Steps, home_within: float, away_beyond: float) -> NDArray[np.bool_]:
    """
    Return whether a composite with these distances [goal radii] holds at each step, (n,).

    The flock is away before the first step. Raises ConfigError without recorded poses.
    """
    if len(steps) and not np.isfinite(steps.home_distance).any():
        raise ConfigError(
            f'{steps.where}: the distance of the flock from the goal is not known, expected poses '
            'of both, by which a policy with two modes learns when to hold; give bags with them, '
            'not a data set, or leave modes at 1'
        )
    home, at_step = False, dict[int, bool]()
    for step, distance in zip(steps.step.tolist(), steps.home_distance.tolist(), strict=True):
        if step not in at_step:
            home = distance <= (away_beyond if home else home_within)
            at_step[step] = home
    return np.array([at_step[step] for step in steps.step.tolist()], np.bool_)
