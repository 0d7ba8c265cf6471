"""Diagnosis of a part of the installation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

Level = Literal['ok', 'warning', 'error']
DIAGNOSIS_LEVELS: tuple[Level, ...] = ('ok', 'warning', 'error')


@dataclass(frozen=True)
class Diagnosis:
    """A part that was checked: how it is, and what to do about it unless it is ok."""

    name: str
    level: Level
    text: str
    fix: str = ''


Check = Callable[[], Iterator[Diagnosis]]


def ok(name: str, text: str) -> Diagnosis:
    """Return a finding of a part that is as it should be."""
    return Diagnosis(name, 'ok', text)


def warning(name: str, text: str, fix: str) -> Diagnosis:
    """Return a finding of a part without which something is missing or slow."""
    return Diagnosis(name, 'warning', text, fix)


def error(name: str, text: str, fix: str) -> Diagnosis:
    """Return a finding of a part without which nodes or verbs fail."""
    return Diagnosis(name, 'error', text, fix)
