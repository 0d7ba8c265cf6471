"""
Damages checkpoints and data sets in every way and opens them: `fuzz.py SEEDS WORK KIND:COUNT ...`.

SEEDS holds whole ones (small.safetensors, bags/*, built), WORK is empty, KIND is checkpoint, bag
or built. The last line of the output is JSON: how many cases ended how, and those that ended
badly. Nothing but ConfigError is allowed; a case that takes too long, too much memory, or runs
what is not ours is bad.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
import io
import json
import os
from pathlib import Path
import pickle
import random
import resource
import shutil
import signal
import struct
import sys
import traceback
from typing import Any

import pyarrow as pa
from pyarrow import parquet
from rosbag2 import fuzz
from shepherd_ros.cli.checkpoint_verbs import _Info
from shepherd_ros.cli.user_error import UserError
from shepherd_ros.config import ConfigError
from shepherd_ros.datasets.examples import count_examples
from shepherd_ros.sim.observation import ObservationConfig
import torch

SECONDS = 20.0  # of CPU time for one case; other load on the machine does not count
MEMORY = 600 << 20  # [bytes] beside what the process has at its start
FORBIDDEN = (
    'compile', 'ctypes.dlopen', 'exec', 'import', 'os.exec', 'os.fork', 'os.posix_spawn',
    'os.system', 'pickle.find_class', 'socket.connect', 'subprocess.Popen',
)  # fmt: skip
OBSERVATION = ObservationConfig(n_frames=2, frame_interval=1.0)
ODD: list[Any] = [
    None, True, 0, 1, -1, 2, 0.5, -0.0, 1e308, 2**31, 2**63, 2**64, 10**30, float('nan'),
    float('inf'), '', 'x', '\ud800', '\x1b[2J', '../../etc', [], [[]], {}, {'x': 1}, [0] * 1000,
    'long' * 5000,
]  # fmt: skip
BYTES = [done for done in fuzz.DAMAGE if done is not fuzz.flip_end]


class Trap:
    """What runs something when it is unpickled."""

    def __reduce__(self) -> Any:
        """Return what unpickling would call."""
        return os.system, ('touch trap',)


def foreign(rng: random.Random) -> bytes:
    """Return the content of a file of another kind."""
    if rng.random() < 0.3:
        file = io.BytesIO()
        torch.save({'weights': torch.ones(2), 'trap': Trap()}, file)
        return file.getvalue()
    kinds = [
        b'', b'\n', b'{}', b'[]', b'null', b'PAR1', b'PAR1' * 3, b'\x1f\x8b\x08' + bytes(30),
        b'\x7fELF' + bytes(100), b'#!/bin/sh\ntouch trap\n', b'import os; os.system("touch trap")',
        pickle.dumps(Trap()), pickle.dumps({'a': [Trap()]}, 0), b'[' * 200_000, b'{"a":' * 50_000,
        b'"\\ud800"', b'\xff\xfe' * 50, struct.pack('<Q', 2) + b'{}', rng.randbytes(500),
    ]  # fmt: skip
    return rng.choice(kinds)


def oddly(data: Any, rng: random.Random) -> Any:
    """Return nested plain data with something odd at one place."""
    if not isinstance(data, dict | list) or not data or rng.random() < 0.1:
        if rng.random() < 0.2:
            nest: Any = 0
            for _ in range(rng.choice([10, 200, 700, 900, 960, 980])):
                nest = [nest] if rng.random() < 0.5 else {'a': nest}
            return nest
        return rng.choice(ODD)
    if isinstance(data, list):
        k = rng.randrange(len(data))
        return [*data[:k], oddly(data[k], rng), *data[k + 1 :]]
    name = rng.choice(list(data))
    if rng.random() < 0.1:
        return {key: value for key, value in data.items() if key != name}
    if rng.random() < 0.1:
        return data | {rng.choice(['x', '', 'dt', '__class__', 'a' * 999]): rng.choice(ODD)}
    return data | {name: oddly(data[name], rng)}


def place(target: Path, rng: random.Random) -> str:
    """Put something that is no plain file where one is expected; return what."""
    target.unlink()
    kind = rng.choice(['none', 'folder', 'fifo', 'loop', 'dangling', 'device', 'sparse', 'huge'])
    if kind == 'folder':
        target.mkdir()
    elif kind == 'fifo':
        os.mkfifo(target)
    elif kind == 'loop':
        target.symlink_to(target.name)
    elif kind == 'dangling':
        target.symlink_to('nowhere')
    elif kind == 'device':
        target.symlink_to('/dev/zero')
    elif kind in ('sparse', 'huge'):
        with target.open('wb') as file:
            file.write(struct.pack('<Q', 100) if rng.random() < 0.5 else foreign(rng))
            file.truncate(900 << 20 if kind == 'sparse' else 6 << 30)
    return kind


# ---- checkpoints ----


def odd_header(data: bytearray, rng: random.Random) -> None:
    """Change what the header says, so that it is whole again: weights, configuration, record."""
    (size,) = struct.unpack_from('<Q', data)
    header = json.loads(data[8 : 8 + size])
    rest = bytes(data[8 + size :])
    for _ in range(rng.choice([1, 1, 1, 3])):
        inside = header.get('__metadata__')
        part = rng.choice(['config', 'config', 'record', 'metadata', 'weights', 'many'])
        if part in ('config', 'record') and isinstance(inside, dict) and part in inside:
            try:
                inside[part] = json.dumps(oddly(json.loads(inside[part]), rng))
            except (RecursionError, TypeError, ValueError):
                inside[part] = '{'
            if rng.random() < 0.05:
                inside[part] = rng.choice(['[', '{"a":']) * rng.choice([500, 5000, 100_000])
        elif part == 'metadata' and isinstance(inside, dict):
            header['__metadata__'] = oddly(inside, rng)
        elif part == 'many':
            like = {'dtype': 'F32', 'shape': [0], 'data_offsets': [0, 0]}
            header |= {f'w{k}': like for k in range(rng.choice([1, 3000]))}
        else:
            name = rng.choice(list(header))
            header[name] = oddly(header[name], rng)
            if rng.random() < 0.3 and isinstance(header[name], dict):
                header[name]['dtype'] = rng.choice(['F64', 'BF16', 'I8', 'BOOL', 'F8_E4M3', 'U64'])
    text = json.dumps(header, ensure_ascii=rng.random() < 0.5)
    raw = text.encode('utf-8', 'surrogatepass')
    data[:] = struct.pack('<Q', len(raw)) + raw + rest


def checkpoint(seeds: Path, work: Path, rng: random.Random) -> str:
    """Make a damaged checkpoint; return what was done."""
    target = work / 'damaged.safetensors'
    data = bytearray((seeds / 'small.safetensors').read_bytes())
    kind = rng.random()
    if kind < 0.03:
        target.touch()
        return place(target, rng)
    if kind < 0.15:
        target.write_bytes(foreign(rng))
        return 'foreign'
    done = odd_header if kind < 0.65 else rng.choice(BYTES)
    done(data, rng)
    target.write_bytes(data)
    return done.__name__


def open_checkpoint(work: Path) -> None:
    """Load a checkpoint and show it, as `shepherd checkpoint info --weights` does."""
    path = str(work / 'damaged.safetensors')
    screen = io.TextIOWrapper(io.BytesIO(), 'utf-8')
    try:
        with redirect_stdout(screen):
            _Info(path, weights=True).run()
    finally:
        screen.flush()
        shown = screen.buffer.getvalue()  # type: ignore[attr-defined]
        assert b'\x1b' not in shown, 'the terminal is told what to do'


# ---- data sets ----


def odd_table(path: Path, rng: random.Random) -> None:
    """Write a whole Parquet file with odd columns or rows."""
    table = parquet.read_table(path)
    kind = rng.randrange(7)
    name = rng.choice(table.column_names)
    at = table.column_names.index(name)
    if kind == 0:
        table = table.drop_columns([name])
    elif kind == 1:
        order = [rng.randrange(len(table)) for _ in range(rng.choice([0, 1, len(table), 50]))]
        table = table.take(pa.array(order, pa.int64()))
    elif kind == 2:
        values = table[name].to_pylist()
        odd = [0, -1, 2**40, 2**63 - 1, -(2**63), None, 1e39, float('nan'), '', [], [[]], [1.0]]
        for _ in range(rng.randrange(1, 4)):
            values[rng.randrange(len(values))] = rng.choice(odd)
        try:
            column = pa.array(values, table.schema.field(at).type)
        except (pa.ArrowException, OverflowError, TypeError, ValueError):
            column = pa.array([str(value) for value in values])
        table = table.set_column(at, name, column)
    elif kind == 3:
        like: Any = rng.choice([0, 1.5, 'text', b'raw', None, [1, 2], {'a': 1}, True])
        table = table.set_column(at, name, pa.array([like] * len(table)))
    elif kind == 4:
        table = pa.concat_tables([table] * rng.randrange(2, 5))
    elif kind == 5 and name == 'bag':
        long = pa.array(['x' * 3_000_000] * len(table))
        table = table.set_column(at, name, long)
    groups = rng.choice([1, 2, 3, 10_000])
    parquet.write_table(
        table, path, row_group_size=groups, compression=rng.choice(['none', 'gzip'])
    )


def built(seeds: Path, work: Path, rng: random.Random) -> str:
    """Make a damaged data set; return what was done."""
    folder = work / 'place'
    shutil.copytree(seeds / 'built', folder)
    target = rng.choice(sorted(path for path in folder.rglob('*') if path.is_file()))
    kind = rng.random()
    if kind < 0.05:
        name = place(target, rng)
    elif kind < 0.15:
        target.write_bytes(foreign(rng))
        name = 'foreign'
    elif kind < 0.5 and target.suffix == '.json':
        odd = oddly(json.loads(target.read_text()), rng)
        target.write_text(json.dumps(odd))
        name = 'odd JSON'
    elif kind < 0.6 and target.suffix == '.parquet':
        odd_table(target, rng)
        name = 'odd table'
    else:
        data = bytearray(target.read_bytes())
        done = rng.choice(BYTES)
        done(data, rng)
        target.write_bytes(data)
        name = done.__name__
    return f'{name} of {target.name}'


def bag(seeds: Path, work: Path, rng: random.Random) -> str:
    """Make a damaged bag; return what was done."""
    source = rng.choice(sorted((seeds / 'bags').iterdir()))
    what = fuzz.damaged(source, work / 'place', rng)
    if rng.random() < 0.05:
        files = sorted(path for path in (work / 'place').iterdir() if path.is_file())
        what += f', {place(rng.choice(files), rng)}'
    note = work / 'place' / 'metadata.yaml'
    if note.is_file() and rng.random() < 0.7:  # it takes long to read, and has tests of its own
        note.unlink()
    return what


def open_place(work: Path) -> None:
    """Read all examples, as `shepherd dataset info` does."""
    count_examples([work / 'place'], OBSERVATION)


KINDS: dict[str, tuple[Callable[[Path, Path, random.Random], str], Callable[[Path], None]]] = {
    'checkpoint': (checkpoint, open_checkpoint),
    'built': (built, open_place),
    'bag': (bag, open_place),
}


def main(seeds: Path, work: Path, requested: list[str]) -> None:
    """Run cases and print how they ended."""
    watching, received = [False], []

    def hear(event: str, arguments: Any) -> None:
        if watching[0] and event in FORBIDDEN:
            received.append(f'{event} {arguments!r:.200}')

    os.chdir(work)
    # as deep as from the shell, where a fork begins deeper
    sys.setrecursionlimit(sys.getrecursionlimit() + len(traceback.extract_stack()))
    for kind, (make, walk) in KINDS.items():  # so that nothing is imported later
        for case in range(-20, 0):
            make(seeds, work, random.Random(f'{kind} {case}'))
            with suppress(ConfigError):
                walk(work)
            clear(work)
    sys.addaudithook(hear)
    watching[0] = True
    pickle.loads(pickle.dumps(Trap()))
    watching[0] = False
    assert received and (work / 'trap').exists(), 'the hook does not hear'
    received.clear()
    clear(work)
    pages = int(Path('/proc/self/statm').read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    before = peak()
    signal.signal(signal.SIGPROF, fuzz.stop)
    ends: Counter[str] = Counter()
    bad = []
    for kind, count in (words.split(':') for words in requested):
        make, walk = KINDS[kind]
        for number in range(int(count)):
            what = f'{kind} {number}, {make(seeds, work, random.Random(number))}'
            signal.setitimer(signal.ITIMER_PROF, SECONDS)
            try:
                watching[0] = True
                try:
                    walk(work)
                finally:
                    watching[0] = False
                ends[f'{kind} opened'] += 1
            except (ConfigError, UserError) as error:
                ends[f'{kind} refused'] += 1
                if len(str(error)) > 1000:
                    bad.append(f'{what}: a message of {len(str(error))} letters: {error!s:.300}')
            except (Exception, fuzz.TooLongError):
                bad.append(f'{what}: {traceback.format_exc()[-1500:]}')
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0)
            if received or (work / 'trap').exists():
                bad.append(f'{what}: it ran {received}')
                received.clear()
            clear(work)
    print(json.dumps({'ends': ends, 'bad': bad, 'more': peak() - before}))


def peak() -> int:
    """Return the most memory that was in use so far [MiB]."""
    status = Path('/proc/self/status').read_text()
    return int(status.split('VmHWM:')[1].split()[0]) >> 10


def clear(work: Path) -> None:
    """Remove what a case left."""
    for path in work.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


if __name__ == '__main__':
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
