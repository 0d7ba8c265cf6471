"""Lost messages of a recorder: gaps in publication numbers, and losses that DDS reports."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass
class SequenceRun:
    """Numbers that one publisher may have given: first and last, and when they were heard."""

    first: int
    last: int
    begun: int
    ended: int

    def gap_to(self, number: int, begun: int) -> int:
        """Return how many are missing before a number heard then; -1 if it cannot come later."""
        return number - 1 - self.last if self.ended < begun else -1


class SequenceNumbers:
    """
    The numbers that messages of one topic have at their publishers.

    rclpy tells the number of a message but not who sent it. So the numbers are sorted into runs,
    at most one for each publisher that was ever there, in a way that explains them with few lost
    messages. With one publisher that is exact. With several, a gap is noticed too, unless one of
    them was silent so far: then the numbers after the gap may as well be its first.
    """

    def __init__(self) -> None:
        """Start with nothing heard."""
        self.publishers: set[bytes] = set()  # that were ever there
        self.runs: list[SequenceRun] = []
        self.missing = self.heard = 0

    def take(self, number: int, look: Callable[[], set[bytes]]) -> SequenceRun:
        """
        Take the number of a message, return the run that it is in.

        look() returns the publishers that are there now.
        """
        self.heard += 1
        fitting = [run for run in self.runs if run.last == number - 1]
        if fitting:
            run = max(fitting, key=lambda run: run.ended)  # whoever sent last may send again
            run.last, run.ended = number, self.heard
            return run
        if self.runs:  # what came before the first one is not lost
            self.publishers |= look()
            explained = len(self.runs) >= len(self.publishers) and self._explain(number)
            if explained:
                return explained
        self.runs.append(SequenceRun(number, number, self.heard, self.heard))
        return self.runs[-1]

    def _explain(self, number: int) -> SequenceRun | None:
        """
        Count as lost what lies in the smallest gap; return the run if the number lies behind it.

        If the gap is between two runs, they become one, and the number begins another.
        """
        gaps: list[tuple[int, SequenceRun, SequenceRun | None]] = [
            (run.gap_to(number, self.heard), run, None) for run in self.runs
        ]
        gaps += [
            (early.gap_to(late.first, late.begun), early, late)
            for early in self.runs
            for late in self.runs
        ]
        gaps = [gap for gap in gaps if gap[0] >= 0]
        if not gaps:  # numbers that go back: a publisher that is gone again
            return None
        missing, run, late = min(gaps, key=lambda gap: gap[0])
        self.missing += missing
        if late is None:
            run.last, run.ended = number, self.heard
            return run
        run.last, run.ended = late.last, late.ended
        self.runs.remove(late)
        return None


class Losses:
    """Counts lost messages per topic."""

    def __init__(self, publishers: Callable[[str], set[bytes]]) -> None:
        """Start with none; publishers(topic) returns the identities of those there now."""
        self.publishers = publishers
        self.topics: defaultdict[str, SequenceNumbers] = defaultdict(SequenceNumbers)
        self.drops: Counter[str] = Counter()
        self.repeats: Counter[str] = Counter()  # of what was lost: the same is in the bag
        self.stamps: dict[str, int] = {}  # [ns] of the last message

    def heard(
        self, topic: str, number: int | None, stamp_ns: int | None = None, dt_ns: int = 0
    ) -> int:
        """
        Return what tells the publisher of a message from the others of its topic.

        number is that of the message at its publisher; None if the middleware has none. What is
        lost between two stamps at most dt apart was one of them, as a state is shown again.
        """
        last = self.stamps.get(topic)
        if stamp_ns is not None:
            self.stamps[topic] = stamp_ns
        if number is None:
            return 0
        numbers = self.topics[topic]
        missing = numbers.missing
        run = numbers.take(number, lambda: self.publishers(topic))
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
        """Return how many are known to be lost, but for repeats; both ways may count the same."""
        names = {*self.topics, *self.drops}
        lost = {n: max(self.topics[n].missing, self.drops[n]) for n in sorted(names)}
        return Counter(lost) - self.repeats

    def earlier(self) -> Counter[str]:
        """Return how many were sent before the first one heard: before the two ends met."""
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
