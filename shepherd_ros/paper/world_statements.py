"""Statements of section 5 on noise, repulsion and the Reynolds flock: figures 6 to 8."""

from __future__ import annotations

from shepherd_ros.paper.claims import ABOVE, BELOW, Clause, HIGH_SHARE
from shepherd_ros.paper.quantities import (
    about,
    above,
    at,
    below,
    change,
    flat_time,
    FLAT_TOLERANCE,
    highest,
    less,
    lowest,
    METHODS,
    P,
    PATH,
    ratio,
    ratio_at,
    RL,
    S,
    SHARE,
    TIME,
)

# by figure, by statement: what holds where it does
WORLD_STATEMENTS: dict[str, dict[str, tuple[Clause, ...]]] = {
    'fig6': {
        'The time of Strömbom rises from a noise of 0.6 m': (
            Clause(
                'time at 0.4 m over that at 0', change(S, TIME, 0.0, 0.4), high=1 + FLAT_TOLERANCE
            ),
            Clause(
                'time at 2 m over that at 0.6 m', change(S, TIME, 0.6, 2.0), low=1 + FLAT_TOLERANCE
            ),
        ),
        'The time of RL does not rise until 1.4 m': (
            flat_time('largest time until 1.4 m over that at 0', RL, lambda x: x <= 1.41, 1.4),
        ),
        'The time of Pierson is constant': (flat_time('largest time over that at 0', P),),
        (
            'Pierson has the longest shepherd paths, at high noise twice those of RL and five '
            'times those of Strömbom'
        ): (
            above('shepherd path, Pierson over the longer of the others', PATH, P, RL, S),
            about(
                'shepherd path at 2 m, Pierson over RL',
                ratio_at(P, RL, PATH, 2.0),
                2.0,
                better=ABOVE,
            ),
            about('shepherd path at 2 m, Pierson over Strömbom', ratio_at(P, S, PATH, 2.0), 5.0),
        ),
        'Shepherd paths of RL are below those of Strömbom until 1 m, then above': (
            below(
                'shepherd path below 1 m, RL over Strömbom', PATH, RL, S, where=lambda x: x < 0.99
            ),
            above(
                'shepherd path above 1 m, RL over Strömbom',
                PATH,
                RL,
                S,
                where=lambda x: x > 1.01,
                better=BELOW,
            ),
        ),
        'Shepherd paths of Strömbom get shorter with noise': (
            Clause('shepherd path at 2 m over that at 0', change(S, PATH, 0.0, 2.0), high=1.0),
        ),
        'All methods succeed at all noises': (
            Clause('smallest share of the flock', lowest(SHARE, METHODS), low=HIGH_SHARE),
        ),
    },
    'fig7': {
        'Pierson and RL bring a high share home up to rho_a = 4': (
            Clause('smallest share, Pierson', lowest(SHARE, (P,)), low=HIGH_SHARE),
            Clause('smallest share, RL', lowest(SHARE, (RL,)), low=HIGH_SHARE),
        ),
        'Strömbom brings a high share home up to 3 and 40 % at 4': (
            Clause(
                'smallest share up to 3', lowest(SHARE, (S,), lambda x: x < 3.01), low=HIGH_SHARE
            ),
            about('share at 4', at(S, SHARE, 4.0), 0.4),
        ),
        'Shepherd paths get shorter with rho_a, slightly for Pierson and RL, much for Strömbom': (
            Clause('path at 4 over that at 1, Pierson', change(P, PATH, 1.0, 4.0), 0.7, 1.0),
            Clause('path at 4 over that at 1, RL', change(RL, PATH, 1.0, 4.0), 0.7, 1.0),
            Clause('path at 4 over that at 1, Strömbom', change(S, PATH, 1.0, 4.0), high=0.7),
        ),
        'Shepherd paths of Strömbom are below those of RL from 3 on': (
            below(
                'shepherd path from 3 on, Strömbom over RL',
                PATH,
                S,
                RL,
                where=lambda x: x > 2.99,
                better=ABOVE,
            ),
            above(
                'shepherd path below 3, Strömbom over RL', PATH, S, RL, where=lambda x: x < 2.99
            ),
        ),
        'Shepherd paths of Strömbom are shorter at 0.5, too': (
            Clause('shepherd path at 0.5 over that at 1', change(S, PATH, 1.0, 0.5), high=1.0),
        ),
    },
    'fig8': {
        'Pierson brings a very high share of the Reynolds flock home': (
            Clause('smallest share, Pierson', lowest(SHARE, (P,)), low=HIGH_SHARE),
        ),
        'Strömbom brings about 10 % of it home at all sizes': (
            Clause('smallest share, Strömbom', lowest(SHARE, (S,)), low=0.0, high=0.2),
            Clause('largest share, Strömbom', highest(SHARE, (S,)), low=0.0, high=0.2),
        ),
        'RL brings a high share home above 30 sheep, a lower one below': (
            Clause(
                'smallest share above 30 sheep',
                lowest(SHARE, (RL,), lambda x: x > 30),
                low=HIGH_SHARE,
            ),
            Clause(
                'share below 30 sheep less that above',
                less(RL, SHARE, lambda x: x < 30, lambda x: x > 30),
                high=0.0,
                better=ABOVE,
            ),
        ),
        'Shepherd paths of Strömbom are less than 66 % of those of RL': (
            Clause('shepherd path, Strömbom over RL', ratio(S, RL, PATH), high=0.66, better=ABOVE),
        ),
        'Shepherd paths of RL grow gently with the flock': (
            Clause(
                'shepherd path with 100 sheep over that with 10',
                change(RL, PATH, 10, 100),
                high=1.5,
            ),
        ),
    },
}
