"""Statements of section 5 on the size of flock and team: figures 4 and 5, and the shares."""

from __future__ import annotations

from shepherd_ros.paper.claims import ABOUT_TOLERANCE, ABOVE, BELOW, Clause, SHARE_TOLERANCE
from shepherd_ros.paper.quantities import (
    about,
    above,
    average,
    below,
    change,
    extent,
    FLAT_TOLERANCE,
    FLOCK,
    gain,
    largest,
    METHODS,
    P,
    PATH,
    quotient,
    ratio,
    ratio_at,
    RL,
    S,
    SHARE,
    slope,
    smallest_ratio,
    SPREAD,
    TIME,
)

# by figure, by statement: what holds where it does
SIZE_STATEMENTS: dict[str, dict[str, tuple[Clause, ...]]] = {
    'fig4': {
        'Pierson is the fastest, in as little as two thirds of the time of RL': (
            below('time, Pierson over RL', TIME, P, RL, better=ABOVE),
            below('time, Pierson over Strömbom', TIME, P, S),
            about(
                'time, Pierson over RL: smallest ratio',
                smallest_ratio(P, RL, TIME),
                2 / 3,
                better=ABOVE,
            ),
        ),
        'Pierson shepherds move about four times as far as those of RL': (
            about('shepherd path, Pierson over RL', ratio(P, RL, PATH), 4.0, better=ABOVE),
        ),
        'RL has the shortest shepherd paths': (
            below('shepherd path, RL over the better of the others', PATH, RL, S, P),
        ),
        'Strömbom has the lowest spread, about 30 % below RL': (
            below('spread, Strömbom over RL', SPREAD, S, RL, better=ABOVE),
            below('spread, Strömbom over Pierson', SPREAD, S, P),
            about('spread, Strömbom over RL', ratio(S, RL, SPREAD), 0.7, better=ABOVE),
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
            about('flock path, RL over Strömbom', ratio(RL, S, FLOCK), 1.0, better=BELOW),
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
            about(
                'flock path with 6, RL over Pierson', ratio_at(RL, P, FLOCK, 6), 0.8, better=BELOW
            ),
        ),
        'The spread of RL is below that of Pierson, about 1.5 that of Strömbom, and flat': (
            below('spread, RL over Pierson', SPREAD, RL, P),
            about('spread, RL over Strömbom', ratio(RL, S, SPREAD), 1.5, better=BELOW),
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
                better=ABOVE,
            ),
        ),
        'RL guides 97.8 % of the flock to the goal': (
            Clause(
                'mean share, RL',
                average(RL, SHARE),
                0.978 - SHARE_TOLERANCE,
                0.978 + SHARE_TOLERANCE,
                better=ABOVE,
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
}
