"""Lost messages of a recorder: gaps in publication numbers, and losses that DDS reports."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass
class SequenceRun:
    """Numbers of one publisher, first and last, and the counts of messages at these."""

    first: int
    last: int
    first_heard: int
    last_heard: int

    def gap_to(self, number: int, first_heard: int) -> int:
        """Return the numbers missing before one of a later run; -1 if that is not later."""
        return number - 1 - self.last if self.last_heard < first_heard else -1


class SequenceNumbers:
    """
    The numbers that messages of one topic have at their publishers.

    rclpy gives the number of a message but not its publisher. So the numbers are sorted into runs,
    at most one for each publisher that ever existed, such that few messages count as lost. With
    one publisher that is exact. With several, a gap is noticed too, unless one of them was silent
    so far: then the numbers after the gap may as well be its first.
    """

    def __init__(self) -> None:
        """Start without messages."""
        self.publishers: set[bytes] = set()  # that were ever there
        self.runs: list[SequenceRun] = []
        self.missing = self.received = 0

    def add(self, number: int, current_publishers: Callable[[], set[bytes]]) -> SequenceRun:
        """
        Add the number of a message, return its run.

        current_publishers() returns the present publishers.
        """
        self.received += 1
        candidates = [run for run in self.runs if run.last == number - 1]
        if candidates:
            run = max(candidates, key=lambda run: run.last_heard)  # the last sender may go on
            run.last, run.last_heard = number, self.received
            return run
        if self.runs:  # what came before the first one is not lost
            self.publishers |= current_publishers()
            bridged = len(self.runs) >= len(self.publishers) and self._close_gap(number)
            if bridged:
                return bridged
        self.runs.append(SequenceRun(number, number, self.received, self.received))
        return self.runs[-1]

    def _close_gap(self, number: int) -> SequenceRun | None:
        """
        Count the smallest gap as lost; return its run if the number lies behind it, else None.

        If the gap is between two runs, they become one, and the number begins another.
        """
        gaps: list[tuple[int, SequenceRun, SequenceRun | None]] = [
            (run.gap_to(number, self.received), run, None) for run in self.runs
        ]
        gaps += [
            (before.gap_to(after.first, after.first_heard), before, after)
            for before in self.runs
            for after in self.runs
        ]
        gaps = [gap for gap in gaps if gap[0] >= 0]
        if not gaps:  # numbers that go back: a publisher that is gone again
            return None
        missing, run, after = min(gaps, key=lambda gap: gap[0])
        self.missing += missing
        if after is None:
            run.last, run.last_heard = number, self.received
            return run
        run.last, run.last_heard = after.last, after.last_heard
        self.runs.remove(after)
        return None


class Losses:
    """Counts lost messages per topic."""

    def __init__(self, publishers: Callable[[str], set[bytes]]) -> None:
        """Start without losses; publishers(topic) returns the ids of its present publishers."""
        self.publishers = publishers
        self.topics: defaultdict[str, SequenceNumbers] = defaultdict(SequenceNumbers)
        self.drops: Counter[str] = Counter()
        self.latched: set[str] = set()  # topics whose publishers keep messages for latecomers
        self.repeats: Counter[str] = Counter()  # of what was lost: the same is in the bag
        self.stamps: dict[str, int] = {}  # [ns] of the last message

    def count_message(
        self, topic: str, number: int | None, stamp_ns: int | None = None, dt_ns: int = 0
    ) -> int:
        """
        Count a message; return an id of its publisher among those of its topic.

        number is that of the message at its publisher; None if the middleware has none. A message
        lost between two stamps at most dt apart is a repeat, as states are published again.
        """
        last = self.stamps.get(topic)
        if stamp_ns is not None:
            self.stamps[topic] = stamp_ns
        if number is None:
            return 0
        numbers = self.topics[topic]
        missing = numbers.missing
        run = numbers.add(number, lambda: self.publishers(topic))
        if last is not None and stamp_ns is not None and len(numbers.runs) == 1:
            self.repeats[topic] += (numbers.missing - missing) * (0 <= stamp_ns - last <= dt_ns)
        return id(run)

    def dropped(self, topic: str, count: int) -> None:
        """Count messages that DDS reports lost."""
        self.drops[topic] += count

    def lost(self, topic: str, event: Any) -> None:
        """Count the losses of an event of DDS."""
        self.dropped(topic, event.total_count_change)

    def by_topic(self) -> Counter[str]:
        """Return the lost messages by topic, without repeats."""
        names = {*self.topics, *self.drops}
        lost = {n: max(self.topics[n].missing, self._reported(n)) for n in sorted(names)}
        return Counter(lost) - self.repeats

    def _reported(self, topic: str) -> int:
        """
        Return how many DDS reports lost since the first that was heard.

        A latched publisher drops old messages while a latecomer gets them, which DDS reports too.
        """
        runs = self.topics[topic].runs if topic in self.latched else []
        return max(self.drops[topic] - sum(run.first - 1 for run in runs), 0)

    def earlier(self) -> Counter[str]:
        """Return the messages by topic that were sent before the first received one."""
        items = self.topics.items()
        return +Counter({name: sum(run.first - 1 for run in n.runs) for name, n in sorted(items)})

    def report(self) -> list[str]:
        """Return a line for each topic with losses."""
        return [
            f'{name}: {self.topics[name].missing} missing in the numbering, {self.drops[name]} '
            'reported by DDS'
            + f', {self.repeats[name]} of them repeats'
            * bool(self.repeats[name])
            for name in self.by_topic()
        ]

    def summary(self, verbose: bool) -> list[str]:
        """Return a line for all losses and one for all that came too early; verbose: by topic."""
        early = self.earlier()
        counts_by_topic = [f'{name}: {count}' for name, count in early.items()]
        return [
            *_shown('lost', self.by_topic(), self.report(), verbose),
            *_shown('sent before the first that was heard', early, counts_by_topic, verbose),
        ]


def _shown(what: str, counts: Counter[str], lines: list[str], verbose: bool) -> list[str]:
    """Return the lines of topics, or one for all of them where there are several."""
    if verbose or len(lines) < 2:
        return [f'{what}: {line}' for line in lines]
    ((name, most),) = counts.most_common(1)
    return [
        f'{what}: {counts.total()} messages of {len(counts)} topics, {most} of them of {name}; '
        '--verbose lists them'
    ]
