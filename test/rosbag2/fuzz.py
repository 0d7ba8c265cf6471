"""
Damages bags in every way and opens them: `python fuzz.py SEEDS WORK FIRST COUNT`.

SEEDS is a folder of whole bags, WORK an empty one. For each case one bag is damaged, always in
the same way for the same number, and goes through everything that reads bags. The last line of
the output is JSON: how many cases ended how, and those that ended badly. Nothing but BagError is
allowed; a case that takes too long or too much memory is bad.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
import json
from pathlib import Path
import random
import resource
import shutil
import signal
import struct
import sys
import traceback
from types import FrameType

from shepherd_ros.recordings.check import check_bag
from shepherd_ros.recordings.episodes import iter_episodes
from shepherd_ros.recordings.info import bag_info
from shepherd_ros.rosbag2.bag import Bag
from shepherd_ros.rosbag2.diff import diff_bags
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.rosbag2.recover import recover

SECONDS = 5.0  # of CPU time for one case; other load on the machine does not count
MEMORY = 400 << 20  # [bytes] beside what the process has at its start


class TooLongError(BaseException):
    """A case that does not come to its end."""


def cut(data: bytearray, rng: random.Random) -> None:
    """Cut the end off, most often somewhere in the middle."""
    del data[rng.randrange(len(data)) :]


def cut_end(data: bytearray, rng: random.Random) -> None:
    """Cut a few bytes off the end."""
    del data[-rng.randrange(1, 60) :]


def front(data: bytearray, rng: random.Random) -> None:
    """Leave the magic, or a little more."""
    del data[rng.randrange(0, 60) :]


def flip(data: bytearray, rng: random.Random) -> None:
    """Flip a few bits anywhere."""
    for _ in range(rng.randrange(1, 9)):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def flip_end(data: bytearray, rng: random.Random) -> None:
    """Flip a few bits of the summary, and forget its checksum."""
    (start,) = struct.unpack_from('<Q', data, len(data) - 28)
    for _ in range(rng.randrange(1, 6)):
        data[rng.randrange(start, len(data) - 37)] ^= 1 << rng.randrange(8)
    data[-12:-8] = bytes(4)


def zero(data: bytearray, rng: random.Random) -> None:
    """Fill a part with zeros, as a file system does after a loss of power."""
    begin = rng.randrange(len(data))
    length = min(rng.randrange(1, 20_000), len(data) - begin)
    data[begin : begin + length] = bytes(length)


def noise(data: bytearray, rng: random.Random) -> None:
    """Fill a part with noise."""
    begin = rng.randrange(len(data))
    length = min(rng.randrange(1, 3000), len(data) - begin)
    data[begin : begin + length] = rng.randbytes(length)


def garbage(data: bytearray, rng: random.Random) -> None:
    """Leave the magic and nothing else of use."""
    keep = rng.choice([0, 8, 8, 40])
    data[keep:] = rng.randbytes(rng.randrange(3000))
    if rng.random() < 0.5:
        data += b'\x02\x14' + bytes(7) + rng.randbytes(20) + b'\x89MCAP0\r\n'


def lengths(data: bytearray, rng: random.Random) -> None:
    """Write a huge or odd number over eight or four bytes, where lengths may be."""
    for _ in range(rng.randrange(1, 4)):
        place = rng.randrange(8, len(data) - 8)
        value = rng.choice([0, 1, 2**31, 2**32 - 1, 2**40, 2**63, 2**64 - 1, rng.randrange(2**28)])
        kind = rng.choice(['<Q', '<I'])
        struct.pack_into(kind, data, place, value % 2 ** (8 * struct.calcsize(kind)))


def shift(data: bytearray, rng: random.Random) -> None:
    """Take a part out, put it in twice or move it."""
    begin = rng.randrange(8, len(data))
    part = data[begin : begin + rng.randrange(1, 5000)]
    if rng.random() < 0.5:
        del data[begin : begin + len(part)]
    place = rng.randrange(8, len(data) + 1)
    data[place:place] = part


DAMAGE: list[Callable[[bytearray, random.Random], None]] = [
    cut, cut_end, front, flip, flip, flip_end, zero, noise, garbage, lengths, lengths, shift,
]  # fmt: skip


def damaged(source: Path, work: Path, rng: random.Random) -> str:
    """Make a damaged copy of a bag; return what was done."""
    shutil.copytree(source, work)
    note = work / 'metadata.yaml'
    done = rng.choice(DAMAGE)
    name = done.__name__
    if rng.random() < 0.1:
        target, name = note, f'{name} of metadata.yaml'
        done = rng.choice([cut, flip, noise, zero, shift])
    else:
        target = rng.choice(sorted(work.glob('*.mcap')))
        if rng.random() < 0.5:
            note.unlink()
    data = bytearray(target.read_bytes())
    done(data, rng)
    target.write_bytes(data)
    return f'{source.name}: {name}'


def read_all(bag: Bag) -> None:
    """Read all messages and all episodes."""
    for _ in bag.messages():
        pass
    for _ in iter_episodes(bag):
        pass


def walk(work: Path, whole: Bag, more: bool) -> str:
    """Do everything with a damaged bag, and even more if asked; return how it ended."""
    ends = []
    try:
        bag = open_bag(work)
    except BagError:
        ends.append('refused')
    else:
        actions: list[Callable[[Bag], object]] = [
            bag_info, check_bag, read_all, lambda b: diff_bags(whole, b),
        ]  # fmt: skip
        for action in actions[: None if more else 2]:
            try:
                action(bag)
            except BagError:
                ends.append('broken')
    try:
        result = recover(work, work.with_name('new'))
        ends.append('recovered')
    except BagError:
        ends.append('lost')
    else:
        new = open_bag(result.folder)  # what was recovered has to be whole
        assert sum(1 for _ in new.messages()) == new.count == result.messages
        if more:
            check_bag(new)
    return 'unharmed' if ends == ['recovered'] else ends[0]


def stop(number: int, frame: FrameType | None) -> None:
    """End a case that takes too long."""
    raise TooLongError


def main(seeds: Path, work: Path, first: int, count: int) -> None:
    """Run cases and print how they ended."""
    pages = int(Path('/proc/self/statm').read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    signal.signal(signal.SIGPROF, stop)
    sources = sorted(path for path in seeds.iterdir() if path.is_dir())
    wholes = {source: open_bag(source) for source in sources}
    ends: Counter[str] = Counter()
    bad = []
    for case in range(first, first + count):
        rng = random.Random(case)
        source = rng.choice(sources)
        what = damaged(source, work / 'bag', rng)
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            ends[walk(work / 'bag', wholes[source], case % 5 == 0)] += 1
        except (Exception, TooLongError):
            bad.append(f'case {case}, {what}: {traceback.format_exc()[-1500:]}')
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
        for path in work.iterdir():
            shutil.rmtree(path)
    status = Path('/proc/self/status').read_text()
    peak = int(status.split('VmHWM:')[1].split()[0]) >> 10
    print(json.dumps({'ends': ends, 'bad': bad, 'peak': peak}))


if __name__ == '__main__':
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
