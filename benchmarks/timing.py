"""Times of work that takes turns, by the wall clock and by CPU time, and tables of rates."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from statistics import median
import time
from typing import Any

CLOCKS = {'wall': time.perf_counter, 'cpu': time.process_time}
Seconds = dict[str, float]  # by clock


def took(work: Callable[[], object]) -> Seconds:
    """Return how long some work takes, by each clock [s]."""
    begun = {name: clock() for name, clock in CLOCKS.items()}
    work()
    return {name: clock() - begun[name] for name, clock in CLOCKS.items()}


def in_turns(works: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, Seconds]:
    """Return the median time of each work, after a warm-up; all run once in every round."""
    for work in works.values():
        work()
    times: dict[str, list[Seconds]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, work in works.items():
            times[name].append(took(work))
    return {
        name: {clock: median(t[clock] for t in seen) for clock in CLOCKS}
        for name, seen in times.items()
    }


def table(title: str, rows: list[dict[str, Any]]) -> None:
    """Print rows as a table."""
    print(f'\n{title}\n| ' + ' | '.join(rows[0]) + ' |\n|---|' + '--:|' * (len(rows[0]) - 1))
    for row in rows:
        cells = (
            f'{v:,.{0 if v >= 50 else 2}f}' if isinstance(v, float) else v for v in row.values()
        )
        print('| ' + ' | '.join(map(str, cells)) + ' |', flush=True)


def rates(name: str, samples: int, seconds: Seconds, beside: Seconds | None) -> dict[str, Any]:
    """Return a row: samples per second by both clocks, as a multiple of another's if given."""
    row: dict[str, Any] = {'what': name}
    for clock, time_taken in seconds.items():
        row[clock] = samples / time_taken
        row[f'{clock}, ratio'] = beside[clock] / time_taken if beside else 1.0
    return row


@contextmanager
def shares_of(
    parts: Mapping[str, list[tuple[Any, str]]], cpu_shares: dict[str, float]
) -> Iterator[None]:
    """Add up the CPU time of methods, given as (object, name), under the name of their part."""

    def timed(part: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            start = time.process_time()
            result = method(*args, **kwargs)
            cpu_shares[part] += time.process_time() - start
            return result

        return call

    places = [(part, *place) for part, methods in parts.items() for place in methods]
    for part, thing, name in places:
        cpu_shares[part] = 0.0
        setattr(thing, name, timed(part, getattr(thing, name)))
    start = time.process_time()
    yield
    elapsed = time.process_time() - start
    for _, thing, name in places:
        delattr(thing, name)
    for part in parts:
        cpu_shares[part] /= elapsed
    cpu_shares['rest'] = 1 - sum(cpu_shares.values())
