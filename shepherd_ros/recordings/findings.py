"""Findings of a check of a bag, and its result."""

from __future__ import annotations

from dataclasses import dataclass, field

MAX_FINDINGS = 1000  # findings that are kept


@dataclass(frozen=True)
class Finding:
    """
    A fault of a recording, with its place.

    kind is one of gap, order, count, type, schema, contract, metadata, stray, absent, damage,
    lost.
    """

    kind: str
    message: str
    episode: int | None = None
    step: int | None = None
    stamp_ns: int | None = None
    topic: str = ''

    def __str__(self) -> str:
        """Return the finding as a sentence that begins with its place."""
        place = [
            f'{name} {value}'
            for name, value in (('episode', self.episode), ('step', self.step))
            if value is not None
        ]
        if self.stamp_ns is not None:
            place.append(f'stamp {self.stamp_ns / 1e9:.9f}')
        if self.topic:
            place.append(self.topic)
        return f'{self.kind}: {", ".join(place)}{": " if place else ""}{self.message}'


@dataclass
class CheckResult:
    """Result of a check of a bag."""

    findings: list[Finding] = field(default_factory=list)  # the first MAX_FINDINGS
    absent: list[str] = field(default_factory=list)  # parts that were not recorded at all
    late: dict[int, int] = field(default_factory=dict)  # first whole step of episodes joined late
    unfinished: list[int] = field(default_factory=list)  # numbers of episodes that end early
    notes: list[str] = field(default_factory=list)
    episodes: int = 0
    steps: int = 0  # states with poses of both kinds

    @property
    def ok(self) -> bool:
        """Return whether there are no findings."""
        return not self.findings

    def add(self, *findings: Finding) -> None:
        """Add findings, at most MAX_FINDINGS in all."""
        self.findings += findings[: MAX_FINDINGS - len(self.findings)]

    def text(self, limit: int = 10) -> str:
        """Return the result in lines for a terminal."""
        lines = [f'{self.episodes} episodes, {self.steps} states']
        if self.absent:
            lines.append(f'not recorded: {", ".join(self.absent)}')
        for number, step in self.late.items():
            lines.append(f'recorded from step {step} on: episode {number}')
        if self.unfinished:
            lines.append(f'unfinished episodes: {", ".join(map(str, self.unfinished))}')
        lines += self.notes
        lines += [str(finding) for finding in self.findings[:limit]]
        if len(self.findings) > limit:
            lines.append(f'and {len(self.findings) - limit} more')
        return '\n'.join([*lines, 'ok' if self.ok else 'not ok'])
