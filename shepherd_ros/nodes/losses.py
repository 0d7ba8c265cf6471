"""What a recorder did not get: gaps in the numbers of publications, and what DDS reports lost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from rclpy.subscription import Subscription

Waiting = tuple[str, bytes, Any]  # topic, message, times


class Losses:
    """Counts lost messages per topic."""

    def __init__(self) -> None:
        """Start with none."""
        self.gaps: Counter[str] = Counter()
        self.drops: Counter[str] = Counter()
        self.last: dict[str, int] = {}

    def follows(self, topic: str, sequence: int | None) -> bool:
        """Return whether a number is the next one of a topic, or its first."""
        before = self.last.get(topic)
        return before is None or sequence is None or sequence == before + 1

    def heard(self, topic: str, sequence: int | None, single: bool) -> None:
        """
        Take the number that a message has at its publisher; None if the middleware has none.

        Only with a single publisher do the numbers follow each other. One that starts anew is
        a publisher that was restarted.
        """
        before = self.last.pop(topic, None)
        if sequence is None or not single:
            return
        self.last[topic] = sequence
        if before is not None and sequence > before + 1:
            self.gaps[topic] += sequence - before - 1

    def dropped(self, topic: str, count: int) -> None:
        """Take what DDS reports lost."""
        self.drops[topic] += count

    def lost(self, topic: str, event: Any) -> None:
        """Take the event by which DDS reports losses."""
        self.dropped(topic, event.total_count_change)

    @property
    def total(self) -> int:
        """Return how many messages are known to be lost; both counts may mean the same ones."""
        return sum(max(self.gaps[t], self.drops[t]) for t in {*self.gaps, *self.drops})

    def report(self) -> list[str]:
        """Return a line for each topic with losses."""
        return [
            f'{topic}: {self.gaps[topic]} missing in the numbering, {self.drops[topic]} reported '
            'by DDS'
            for topic in sorted({*self.gaps, *self.drops})
            if self.gaps[topic] or self.drops[topic]
        ]


def waiting(inputs: Mapping[str, Subscription | None], depth: int) -> list[Waiting]:
    """Return what has come and was not taken yet, in the order in which it came."""
    rows: list[Waiting] = []
    for name, subscription in inputs.items():
        if subscription is None:
            continue
        with subscription.handle:
            for _ in range(depth):
                taken = subscription.handle.take_message(subscription.msg_type, True)
                if taken is None:
                    break
                rows.append((name, *taken))
    return sorted(rows, key=lambda row: int(row[2]['received_timestamp']))
