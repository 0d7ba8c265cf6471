#!/usr/bin/env python3
"""
Kill -9 a live recorder at random moments and see what is left of its bag.

The stack runs, and two recorders listen: one is killed, the other is not and knows what there was.
What is recovered has to be a part without gaps of each topic, at least as much as lies on the disk
in whole chunks, equal for every reader; and the check has to say that the episode is unfinished.
"""

import argparse
from collections import defaultdict
from contextlib import ExitStack, suppress
import json
import os
from pathlib import Path
import random
import signal
import tempfile
import time

from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from recorder_load import recorder
from rosbags.highlevel import AnyReader
from shepherd_ros.bringup import herding_stack
from shepherd_ros.cli.processes import isolate, running
from shepherd_ros.recordings.check import check_bag
from shepherd_ros.recordings.recording_writer import LOST_KEY
from shepherd_ros.rosbag2.bag import Bag
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.rosbag2.recover import recover

WORDS = ('-x', 'diagnostics|markers')  # several publish them, in an order of each recorder


def until_there(folder: Path) -> None:
    """Wait until a bag is begun."""
    deadline = time.monotonic() + 20
    while not folder.exists() and time.monotonic() < deadline:
        time.sleep(0.01)


def by_topic(bag: Bag) -> dict[str, list[bytes]]:
    """Return the messages of each topic."""
    rows = defaultdict(list)
    for message in bag.messages():
        rows[message.topic].append(message.data)
    return rows


def on_disk(file: Path) -> int:
    """Return how many messages lie in whole chunks of a torn file."""
    count = 0
    with file.open('rb') as stream, suppress(EndOfFile):
        for record in StreamReader(stream).records:
            count += isinstance(record, Message)
    return count


def is_part(part: list[bytes], whole: list[bytes]) -> bool:
    """Return whether a list lies in another one without gaps."""
    starts = [i for i, row in enumerate(whole) if part and row == part[0]]
    return not part or any(whole[i : i + len(part)] == part for i in starts)


def kill_once(root: Path, seconds: float) -> str:
    """Kill a recorder after some seconds of recording; return a row of the table."""
    torn, whole = root / 'torn', root / 'whole'
    with ExitStack() as stack, recorder(whole, *WORDS) as whole_recorder:
        until_there(whole)
        time.sleep(1.0)  # it hears all that the other one will
        victim = stack.enter_context(recorder(torn, *WORDS))
        until_there(torn)
        time.sleep(seconds)
        victim.send_signal(signal.SIGKILL)
        victim.wait()
        killed_ns = time.time_ns()
        time.sleep(0.3)
        whole_recorder.send_signal(signal.SIGINT)
        whole_recorder.communicate(timeout=60)
    flushed = on_disk(torn / 'torn_0.mcap')
    result = recover(torn)
    bag = open_bag(result.folder)
    assert result.messages == bag.count >= flushed, (result, flushed)
    truth = by_topic(open_bag(whole))
    lost = json.loads(open_bag(whole).custom_data[LOST_KEY])
    for topic, rows in by_topic(bag).items():
        alike = topic in lost or is_part(rows, truth[topic])
        assert alike, f'{topic}: not what was sent'
    with AnyReader([result.folder]) as reader:
        theirs = sum(1 for _ in reader.messages())
    with next(result.folder.glob('*.mcap')).open('rb') as stream:
        decoded = make_reader(stream, decoder_factories=[DecoderFactory()])
        ros2 = sum(1 for _ in decoded.iter_decoded_messages())
    assert bag.count == theirs == ros2, (bag.count, theirs, ros2)
    check = check_bag(bag)
    assert check.unfinished, check.text()
    missing = (killed_ns - bag.end_ns) / 1e9
    cells = [f'{seconds:.2f}', flushed, bag.count, f'{missing:.2f}']
    return '| ' + ' | '.join(map(str, cells)) + ' |'


def main() -> None:
    """Kill as often as asked for and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--times', type=int, default=20)
    parser.add_argument('--seed', type=int, default=0)
    options = parser.parse_args()
    isolate(os.environ)
    moments = random.Random(options.seed)
    names = (
        'killed after [s]',
        'in whole chunks',
        'recovered',
        'missing at the end [s]',
        'findings',
    )
    print('| ' + ' | '.join(names) + ' |\n|' + '--:|' * len(names))
    with tempfile.TemporaryDirectory() as folder, running(Path(folder, 'logs')) as stack:
        nodes = herding_stack(mode='realtime', rate=40.0)
        stack.start([p for p in nodes if p.executable != 'metrics'])
        time.sleep(4.0)
        for k in range(options.times):
            root = Path(folder, str(k))
            root.mkdir()
            print(kill_once(root, moments.uniform(0.0, 4.0)), flush=True)
            stack.check()


if __name__ == '__main__':
    main()
