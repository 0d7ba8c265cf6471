"""The statements of section 5 of the paper, figure by figure; RL is a policy of ours."""

from __future__ import annotations

from shepherd_ros.paper.claims import ABOUT_TOLERANCE, Claim, Clause, SHARE_TOLERANCE
from shepherd_ros.paper.quantities import (
    about,
    above,
    at,
    average,
    below,
    change,
    extent,
    flat_time,
    FLAT_TOLERANCE,
    gain,
    highest,
    largest,
    less,
    lowest,
    quotient,
    ratio,
    ratio_at,
    slope,
    smallest_ratio,
    TIME,
)

PATH = 'shepherd_path_length'
SPREAD, FLOCK, SHARE = 'flock_spread', 'flock_path_length', 'fraction_reached'
RL, S, P = 'RL', 'strombom', 'pierson'
METHODS = (RL, S, P)
HIGH_SHARE = 0.9  # a `high` share of the flock

# by figure, by statement: what holds where it does
STATEMENTS: dict[str, dict[str, tuple[Clause, ...]]] = {
    'fig4': {
        'Pierson is the fastest, in as little as two thirds of the time of RL': (
            below('time, Pierson over the better of the others', TIME, P, RL, S),
            about('time, Pierson over RL: smallest ratio', smallest_ratio(P, RL, TIME), 2 / 3),
        ),
        'Pierson shepherds move about four times as far as those of RL': (
            about('shepherd path, Pierson over RL', ratio(P, RL, PATH), 4.0),
        ),
        'RL has the shortest shepherd paths': (
            below('shepherd path, RL over the better of the others', PATH, RL, S, P),
        ),
        'Strömbom has the lowest spread, about 30 % below RL': (
            below('spread, Strömbom over the lower of the others', SPREAD, S, RL, P),
            about('spread, Strömbom over RL', ratio(S, RL, SPREAD), 0.7),
        ),
        'Pierson has the largest spread': (
            above('spread, Pierson over the larger of the others', SPREAD, P, RL, S),
        ),
        'The spread of RL and of Strömbom grows with the flock at similar rates': (
            Clause('spread per sheep, RL [m]', slope(RL, SPREAD), low=0.0),
            Clause('spread per sheep, Strömbom [m]', slope(S, SPREAD), low=0.0),
            Clause(
                'rate of RL over that of Strömbom',
                quotient(slope(RL, SPREAD), slope(S, SPREAD)),
                0.5,
                2.0,
            ),
        ),
        'The flock path of RL is about that of Strömbom, that of Pierson is larger': (
            about('flock path, RL over Strömbom', ratio(RL, S, FLOCK), 1.0),
            above('flock path, Pierson over the larger of the others', FLOCK, P, RL, S),
        ),
    },
    'fig5': {
        'All methods get faster with more shepherds, with little gain after 3 to 4': (
            Clause(
                'time with 6 over that with 1, the slowest to gain',
                largest([change(m, TIME, 1, 6) for m in METHODS]),
                high=1.0,
            ),
            Clause(
                'gain from 4 to 6 over the time with 1, largest',
                largest([gain(m, 4, 6, 1) for m in METHODS]),
                high=FLAT_TOLERANCE,
            ),
        ),
        'Shepherd paths of RL grow with the team, both baselines stay above double': (
            Clause('shepherd path per shepherd more, RL [m]', slope(RL, PATH), low=0.0),
            above('shepherd path, Strömbom over RL', PATH, S, RL, least=2.0),
            above('shepherd path, Pierson over RL', PATH, P, RL, least=2.0),
        ),
        'The flock path of RL grows to about 80 % of that of Pierson': (
            Clause('flock path per shepherd more, RL [m]', slope(RL, FLOCK), low=0.0),
            about('flock path with 6, RL over Pierson', ratio_at(RL, P, FLOCK, 6), 0.8),
        ),
        'The spread of RL is below that of Pierson, about 1.5 that of Strömbom, and flat': (
            below('spread, RL over Pierson', SPREAD, RL, P),
            about('spread, RL over Strömbom', ratio(RL, S, SPREAD), 1.5),
            Clause(
                'largest less smallest spread of RL over its mean',
                quotient(extent(RL, SPREAD), average(RL, SPREAD)),
                high=ABOUT_TOLERANCE,
            ),
        ),
    },
    'fractions': {
        'Pierson guides 100 % of the flock to the goal': (
            Clause('mean share, Pierson', average(P, SHARE), low=1 - SHARE_TOLERANCE),
        ),
        'Strömbom guides 95.8 % of the flock to the goal': (
            Clause(
                'mean share, Strömbom',
                average(S, SHARE),
                0.958 - SHARE_TOLERANCE,
                0.958 + SHARE_TOLERANCE,
            ),
        ),
        'RL guides 97.8 % of the flock to the goal': (
            Clause(
                'mean share, RL',
                average(RL, SHARE),
                0.978 - SHARE_TOLERANCE,
                0.978 + SHARE_TOLERANCE,
            ),
        ),
        'The shares hardly change with flock and team': (
            Clause(
                'largest less smallest share, worst method',
                largest([extent(m, SHARE) for m in METHODS]),
                high=0.05,
            ),
        ),
    },
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
            about('shepherd path at 2 m, Pierson over RL', ratio_at(P, RL, PATH, 2.0), 2.0),
            about('shepherd path at 2 m, Pierson over Strömbom', ratio_at(P, S, PATH, 2.0), 5.0),
        ),
        'Shepherd paths of RL are below those of Strömbom until 1 m, then above': (
            below(
                'shepherd path below 1 m, RL over Strömbom', PATH, RL, S, where=lambda x: x < 0.99
            ),
            above(
                'shepherd path above 1 m, RL over Strömbom', PATH, RL, S, where=lambda x: x > 1.01
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
                'shepherd path from 3 on, Strömbom over RL', PATH, S, RL, where=lambda x: x > 2.99
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
            ),
        ),
        'Shepherd paths of Strömbom are less than 66 % of those of RL': (
            Clause('shepherd path, Strömbom over RL', ratio(S, RL, PATH), high=0.66),
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
CLAIMS = tuple(
    Claim(figure, text, clauses)
    for figure, statements in STATEMENTS.items()
    for text, clauses in statements.items()
)
