"""Statements on payload protection, the second task; RL is the policy that was trained for it."""

from __future__ import annotations

from shepherd_ros.paper.claims import Claim, Clause, SHARE_TOLERANCE
from shepherd_ros.paper.quantities import (
    at_less,
    difference_at,
    RL,
    slope,
    smallest_difference,
)

_CLEAN = 'clean_success'
_MARGIN = 0.2  # of clean success, by which a team beats a static formation
_LOSS = 0.1  # of clean success, which is little

# by experiment, by statement: what holds where it does
PROTECTION_STATEMENTS: dict[str, dict[str, tuple[Clause, ...]]] = {
    'escorts': {
        'One escort is better than none': (
            Clause(
                'clean success, one escort less idle',
                difference_at(RL, 'idle', _CLEAN, 1),
                low=SHARE_TOLERANCE,
            ),
        ),
        'More escorts, more success': (
            Clause('clean success per escort more', slope(RL, _CLEAN), low=0.0),
            Clause(
                'clean success, six escorts less one',
                at_less(RL, _CLEAN, 6, 1),
                low=SHARE_TOLERANCE,
            ),
        ),
        'A team of any size is better than a static ring': (
            Clause(
                'clean success less that of the ring: smallest',
                smallest_difference(RL, 'ring', _CLEAN),
                low=_MARGIN,
            ),
        ),
        'A team of any size is better than a huddle': (
            Clause(
                'clean success less that of the huddle: smallest',
                smallest_difference(RL, 'huddle', _CLEAN),
                low=SHARE_TOLERANCE,
            ),
        ),
    },
    'pedestrians': {
        'A team is better than a static ring at every density': (
            Clause(
                'clean success less that of the ring: smallest',
                smallest_difference(RL, 'ring', _CLEAN),
                low=_MARGIN,
            ),
        ),
        'What holds at 40 pedestrians holds at 100': (
            Clause(
                'clean success, 100 pedestrians less 40', at_less(RL, _CLEAN, 100, 40), low=-_LOSS
            ),
        ),
    },
    'escort_noise': {
        'Noise of 1 m costs little': (
            Clause('clean success at 1 m less that at 0', at_less(RL, _CLEAN, 1, 0), low=-_LOSS),
        ),
        'With noise of 2 m it is better than a static ring that sees as badly': (
            Clause(
                'clean success at 2 m less that of the ring',
                difference_at(RL, 'ring', _CLEAN, 2),
                low=SHARE_TOLERANCE,
            ),
        ),
    },
}
PROTECTION_CLAIMS = tuple(
    Claim(experiment, text, clauses)
    for experiment, statements in PROTECTION_STATEMENTS.items()
    for text, clauses in statements.items()
)
