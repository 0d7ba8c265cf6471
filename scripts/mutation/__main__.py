"""
Draw mutants of a room and run the tests that hold their lines.

`python -m scripts.mutation wire --sample 200 --seed 0` prints how many mutants the tests kill, and
lists those that survive; it goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import ast
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
import gc
import importlib
from itertools import accumulate
import json
import os
from pathlib import Path
import tempfile

from .apply import Changed, module_name, swap
from .mutants import Mutant, mutants_of, sample
from .session import alone, collected, forked, Item, Items, Loop, read_trace, trace

ROOT = Path(__file__).resolve().parents[2]
# room -> where tests are that run its code without processes of their own, and end soon
EPISODES = 'recordings/test_episodes.py'
TESTS = {
    'sim': ('sim',),
    'wire': ('wire', EPISODES, 'recordings/test_check.py'),
    'rosbag2': ('rosbag2', EPISODES, 'recordings/test_info_diff_export.py'),
    'controllers': ('controllers',),
}
TABLES = 'test/test_generate.py'  # holds what schemas and tables of the manual are made from
HEAVY = (
    'hypothesis', 'jsonschema', 'matplotlib.pyplot', 'mcap.reader', 'numba', 'numpy', 'pyarrow',
    'rosbags.typesys', 'safetensors.torch', 'torch', 'tyro', 'yaml',
)  # fmt: skip
SURVIVED, KILLED, AT_IMPORT = 0, 1, 3  # exit status of a fork

Work = Callable[[], int | None]  # returns the exit status of a fork
Told = Callable[[Mutant, int | None], None]  # hears the status of a mutant, None for too long


@cache
def text_of(path: str) -> str:
    """Return the text of a file of the project."""
    return (ROOT / path).read_text(encoding='utf-8')


@cache
def statements(path: str) -> list[tuple[int, int]]:
    """Return first and last line of each statement of a file, of its head where it has a body."""
    found = []
    for node in ast.walk(ast.parse(text_of(path))):
        if isinstance(node, ast.stmt | ast.ExceptHandler):
            body = getattr(node, 'body', None)
            first = min([node.lineno, *(d.lineno for d in getattr(node, 'decorator_list', ()))])
            found.append((first, body[0].lineno - 1 if body else node.end_lineno or first))
    return found


class Holders:
    """Which tests hold a mutant, by the lines that each test runs."""

    def __init__(self, trace_of_room: Path, own: str, budget: float) -> None:
        """Read the trace; the tests of one mutant take at most the budget [s] of CPU."""
        self.seconds, self.lines = read_trace(trace_of_room)
        self.own, self.budget = own, budget

    def names(self, mutant: Mutant) -> tuple[list[str], bool]:
        """Return the tests, those of the room first, and whether the line runs at import."""
        lines = self.lines[mutant.path]
        spans = [span for span in statements(mutant.path) if span[0] <= mutant.line <= span[1]]
        first, last = min(spans, key=lambda span: span[1] - span[0])
        found = {name for line in range(first, last + 1) for name in lines.get(line, ())}
        at_import = 'import' in found or not found
        if at_import:  # constants, defaults: whatever runs this file, or else this room
            found |= {name for names in lines.values() for name in names}
            if not found & self.seconds.keys():
                found = set(self.seconds)
        order = sorted(found & self.seconds.keys(), key=self._rank)
        used = accumulate(self.seconds[name] for name in order)
        few = sum(1 for total in used if total < self.budget)
        return order[:few], at_import

    def _rank(self, name: str) -> tuple[bool, float]:
        return not name.startswith(self.own), self.seconds[name]

    def limits(self, names: Sequence[str]) -> tuple[float, float]:
        """Return the limits of CPU and wall time for some tests [s]."""
        expected = sum(self.seconds[name] for name in names)
        return 10 + 5 * expected, 120 + 50 * expected


class Run:
    """A sample of one room, and what becomes of each mutant."""

    def __init__(self, out: Path, room: str, compiled: bool, budget: float) -> None:
        """Trace the tests of the room, unless that is done; compiled forms as plain Python."""
        self.compiled = compiled
        self.folders = [f'test/{name}' for name in TESTS[room]]
        path = out / f'{room}_{"compiled" if compiled else "plain"}.json'
        if not path.exists():
            files = [path for path in files_of(room) if ('_compiled' in path) == compiled]
            self.begin(partial(trace, files, self.folders, ROOT, path), 3600)
        self.holders = Holders(path, f'test/{room}/', budget)

    def begin(self, work: Work, seconds: float, wall: float = 7200) -> int | None:
        """Return what a silent fork returns."""

        def quiet() -> int:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, 1)
            os.dup2(nowhere, 2)
            if self.compiled:
                importlib.import_module('numba').config.DISABLE_JIT = True
            return work() or 0

        return forked(quiet, seconds, wall)

    def living(self, mutants: Sequence[Mutant], told: Told) -> None:
        """Run mutants of functions in forks of one session; tell what becomes of each."""

        def work(loop: Loop, items: Items) -> None:
            for mutant in mutants:
                names, at_import = self.holders.names(mutant)
                if at_import:
                    continue
                tests = partial(self._living, loop, mutant, [items[name] for name in names])
                told(mutant, forked(tests, *self.holders.limits(names)))

        self.begin(partial(collected, self.folders, work), 7200)

    def _living(self, loop: Loop, mutant: Mutant, tests: list[Item]) -> int:
        path, before = str(ROOT / mutant.path), text_of(mutant.path)
        if not swap(path, before, str(mutant.source(before))):
            return AT_IMPORT
        return SURVIVED if loop.passes(tests) else KILLED

    def at_import(self, mutant: Mutant) -> int | None:
        """Return what becomes of a mutant that a new session imports."""
        names, _ = self.holders.names(mutant)
        status = self._imported(mutant, names, *self.holders.limits(names))
        return self._imported(mutant, [TABLES], 60, 600) if status == SURVIVED else status

    def _imported(
        self, mutant: Mutant, tests: list[str], seconds: float, wall: float
    ) -> int | None:
        source = str(mutant.source(text_of(mutant.path)))

        def work() -> int:
            Changed(module_name(mutant.path), str(ROOT / mutant.path), source)
            return SURVIVED if alone(tests) else KILLED

        return self.begin(work, seconds, wall)


def files_of(room: str) -> list[str]:
    """Return the files of a room, from the root of the project."""
    paths = (ROOT / 'shepherd_ros' / room).rglob('*.py')
    return sorted(path.relative_to(ROOT).as_posix() for path in paths)


def outcome(status: int | None) -> str:
    """Return the word for an exit status."""
    return {None: 'timed out', SURVIVED: 'survived'}.get(status, 'killed')


def stored(path: Path) -> dict[Mutant, str]:
    """Return the outcomes that a run before has written."""
    rows = path.read_text(encoding='utf-8').splitlines() if path.exists() else []
    return {Mutant(**row['mutant']): row['outcome'] for row in map(json.loads, rows)}


def run(room: str, options: argparse.Namespace) -> dict[Mutant, str]:
    """Return what becomes of a sample of a room, and write each mutant as it is known."""
    mutants = [mutant for path in files_of(room) for mutant in mutants_of(ROOT / path, ROOT)]
    drawn = sample(mutants, options.sample, options.seed, ROOT)
    path = options.out / f'{room}_{options.seed}.jsonl'
    done = stored(path)

    def told(mutant: Mutant, status: int | None) -> None:
        if status != AT_IMPORT:
            row = {'mutant': vars(mutant), 'outcome': outcome(status)}
            with path.open('a', encoding='utf-8') as file:
                file.write(json.dumps(row) + '\n')

    for compiled in (False, True):
        left = [m for m in drawn if ('_compiled' in m.path) == compiled and m not in done]
        if left:
            part = Run(options.out, room, compiled, options.budget)
            part.living(left, told)
            for mutant in left:
                if mutant not in stored(path):
                    told(mutant, part.at_import(mutant))
    done = stored(path)
    return {mutant: done[mutant] for mutant in drawn}


def report(room: str, outcomes: dict[Mutant, str]) -> Iterator[str]:
    """Yield the share of the killed, and a line for each mutant that is not."""
    count = Counter(outcomes.values())
    share = 1 - count['survived'] / max(len(outcomes), 1)
    yield f'{room}: {share:.1%} of {len(outcomes)} killed, {count["timed out"]} by their time'
    for mutant in sorted(outcomes, key=lambda mutant: (mutant.path, mutant.line)):
        if outcomes[mutant] != 'killed':
            shown = mutant.shown(text_of(mutant.path))
            yield f'  {outcomes[mutant]}: {mutant.path}:{mutant.line}: {shown}'


def main() -> None:
    """Print a report of each room."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('rooms', nargs='*', help=f'some of {", ".join(TESTS)}')
    parser.add_argument('--sample', type=int, default=200, help='mutants of each room')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--budget', type=float, default=30.0, help='seconds of CPU for a mutant')
    parser.add_argument('--out', type=Path, default=ROOT / 'out' / 'mutation')
    options = parser.parse_args()
    unknown = set(options.rooms) - TESTS.keys()
    if unknown:
        parser.error(f'unknown {", ".join(sorted(unknown))}: expected some of {", ".join(TESTS)}')
    options.out.mkdir(parents=True, exist_ok=True)
    os.chdir(ROOT)
    with tempfile.TemporaryDirectory(prefix='mutation') as folder:
        os.environ |= {'HYPOTHESIS_STORAGE_DIRECTORY': folder, 'OMP_NUM_THREADS': '1'}
        for name in HEAVY:
            importlib.import_module(name)
        gc.freeze()
        for room in options.rooms or TESTS:
            print('\n'.join(report(room, run(room, options))), flush=True)


if __name__ == '__main__':
    main()
