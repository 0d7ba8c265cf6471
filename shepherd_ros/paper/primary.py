"""Primary policies, which stand for the paper's RL: one for each flock; others are variants."""

from __future__ import annotations

from collections.abc import Sequence

from shepherd_ros.config import ConfigError
from shepherd_ros.experiments.methods import full_name, training_of
from shepherd_ros.sim.flocking import PAPER_FLOCKS

DEFAULT = {'strombom': 'policy:paper_network', 'reynolds': 'policy:reynolds'}
# preset -> flock -> policy; presets that are not named have those of the default preset
PRIMARY = {'third': {'strombom': 'policy:third_strombom', 'reynolds': 'policy:third_reynolds'}}


def trained_on(policy: str) -> set[str]:
    """Return the flocks that a policy was trained with, from its checkpoint."""
    task = training_of(policy).get('task')
    flock = task.get('flock') if isinstance(task, dict) else None
    return set(PAPER_FLOCKS) if flock == 'both' else {str(flock)}


def primary_policies(preset: str, named: Sequence[str] = ()) -> dict[str, str]:
    """
    Return the primary policy of each flock, by its full name; or raise ConfigError.

    Each of those named stands for the flock that it was trained with, instead of that of PRIMARY.
    """
    chosen: dict[str, str] = {}
    for name in map(full_name, named):
        for flock in sorted(trained_on(name) & set(PAPER_FLOCKS)):
            if flock in chosen:
                raise ConfigError(
                    f'primary is {chosen[flock]} and {name}: expected one policy for the {flock} '
                    'flock'
                )
            chosen[flock] = name
    return PRIMARY.get(preset, DEFAULT) | chosen
