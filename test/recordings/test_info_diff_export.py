"""Contents of a bag, differences of two bags, and tables for other tools."""

from __future__ import annotations

import json
from pathlib import Path
import re
from typing import Any

import numpy as np
from pyarrow import csv, parquet
import pytest
from rosbag2.tiny import (
    cdr,
    make,
    N_SHEEP,
    N_SHEPHERDS,
    recording,
    scan_of,
    STEPS,
    tiny_bag,
    without,
    write,
)
from shepherd_ros.config import ConfigError
from shepherd_ros.recordings.export import export_bag
from shepherd_ros.recordings.info import bag_info
from shepherd_ros.rosbag2.bag import Bag
from shepherd_ros.rosbag2.diff import diff_bags
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.rosbag2.reader import open_bag

MESSAGES, TRUTH = recording()


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Bag:
    """Return the tiny bag."""
    return open_bag(tiny_bag(tmp_path_factory.mktemp('t') / 'bag', compression='zstd'))


# ---- info ----


def test_info_tells_what_is_there(bag: Bag) -> None:
    info = bag_info(bag)
    assert info.files == ['bag_0.mcap']
    assert info.size == (bag.path / 'bag_0.mcap').stat().st_size
    assert (info.storage, info.distro, info.compression) == ('mcap', 'jazzy', 'zstd')
    assert (info.start_ns, info.end_ns) == (MESSAGES[0].log_ns, MESSAGES[-1].log_ns)
    assert info.messages == len(MESSAGES)
    assert [(e.number, e.seed, e.states, e.whole) for e in info.episodes] == [
        (0, 7, STEPS + 1, True),
        (1, 8, STEPS + 1, True),
    ]


def test_info_reads_like_ros2_bag_info(bag: Bag) -> None:
    lines = bag_info(bag).text().splitlines()
    for line, pattern in zip(
        lines,
        (
            r'Files:             bag_0\.mcap',
            r'Bag size:          \d+\.\d KiB',
            r'Storage id:        mcap',
            r'ROS Distro:        jazzy',
            r'Compression:       zstd',
            r'Duration:          0\.123000000s',
            r'Start:             Nov 1\d 2023 \d\d:\d\d:\d\d\.000000000 \(1700000000\.000000000\)',
            r'End:               Nov 1\d 2023 \d\d:\d\d:\d\d\.123000000 \(1700000000\.123000000\)',
            r'Messages:          124',
            r'Topic information: Topic: /clock \| Type: rosgraph_msgs/msg/Clock \| Count: 10 \| '
            r'Serialization Format: cdr',
            r' {19}Topic: /episode \| Type: std_msgs/msg/String \| Count: 2 \| .*',
        ),
        strict=False,
    ):
        assert re.fullmatch(pattern, line), line
    assert lines[-2:] == [
        f'{name:<19}Episode: {k} | Seed: {7 + k} | Sheep: 5 | Shepherds: 2 | '
        'States: 5 of 5 | whole'
        for k, name in enumerate(('Episodes:', ''))
    ]


def test_info_of_a_part_and_of_nothing(tmp_path: Path) -> None:
    part = bag_info(open_bag(write(tmp_path / 'part', MESSAGES[:74])))
    assert [(e.states, e.whole) for e in part.episodes] == [(5, True), (1, False)]
    assert part.text().endswith('States: 1 of 5 | not whole')
    empty = bag_info(open_bag(write(tmp_path / 'empty', [])))
    assert (empty.messages, empty.duration_ns, empty.episodes, empty.compression) == (
        0,
        0,
        [],
        'none',
    )
    assert 'Messages:          0\nTopic information:\nEpisodes:' in empty.text()


def test_info_reads_a_bag_once(bag: Bag, monkeypatch: pytest.MonkeyPatch) -> None:
    """But for the topic that announces episodes, which is looked at first."""
    read: list[set[str]] = []
    messages = Bag.messages

    def counting(self: Bag, topics: Any = None, **options: Any) -> Any:
        read.append(set(topics))
        return messages(self, topics, **options)

    monkeypatch.setattr(Bag, 'messages', counting)
    text = bag_info(bag, metrics=True).text()
    assert read == [{'/episode'}, {'/flock/poses', '/shepherds/poses', '/goal'}]
    assert 'Metrics:' in text


def test_a_topic_of_others_with_a_name_of_ours_is_no_episode(tmp_path: Path) -> None:
    row = MESSAGES[0]._replace(type='std_msgs/msg/Float64', data=bytes(12))
    info = bag_info(open_bag(write(tmp_path / 'bag', [row])), metrics=True)
    assert (info.messages, info.episodes) == (1, [])


# ---- diff ----


def changed(folder: Path, bag: Bag, index: int, **fields: Any) -> str:
    """Return how a bag differs from one with another message at a place."""
    rows = list(MESSAGES)
    rows[index] = rows[index]._replace(**fields)
    result = diff_bags(bag, open_bag(write(folder, rows)))
    return '\n'.join(str(topic) for topic in result.topics if not topic.equal)


def test_a_bag_equals_itself_in_any_packing(bag: Bag, tmp_path: Path) -> None:
    other = open_bag(tiny_bag(tmp_path / 'b', chunk_size=500, split_bytes=9000))
    result = diff_bags(bag, other, times=True)
    assert result.equal
    assert result.text().splitlines()[0] == '/clock: 10 equal messages'


def test_padding_and_nan_make_no_difference(tmp_path: Path) -> None:
    ranges = np.array([np.nan, np.inf, 1.0])
    data = bytearray(scan_of(10**9, ranges, 'ab'))  # frame of 3 bytes, then one of padding
    assert data[4 + 8 + 4 + 3] == 0
    left = write(
        tmp_path / 'l',
        [MESSAGES[5]._replace(topic='/s', type='sensor_msgs/msg/LaserScan', data=bytes(data))],
    )
    data[4 + 8 + 4 + 3] = 77
    right = write(
        tmp_path / 'r',
        [MESSAGES[5]._replace(topic='/s', type='sensor_msgs/msg/LaserScan', data=bytes(data))],
    )
    assert diff_bags(open_bag(left), open_bag(right)).equal


def test_the_first_difference_is_named(bag: Bag, tmp_path: Path) -> None:
    place = [i for i, m in enumerate(MESSAGES) if m.topic == '/metrics/flock_spread'][3]
    assert changed(tmp_path / 'n', bag, place, data=cdr(make('Float64', data=2.5))) == (
        '/metrics/flock_spread: 10 and 10 messages; number 3: data: 3.0 and 2.5'
    )
    place = [i for i, m in enumerate(MESSAGES) if m.topic == '/shepherd_0/scan/goal'][1]
    ranges = TRUTH[1].scans[0, 2].copy()
    ranges[4] = 0.5
    output = changed(tmp_path / 's', bag, place, data=scan_of(TRUTH[1].stamp_ns, ranges))
    assert re.fullmatch(
        r'/shepherd_0/scan/goal: 10 and 10 messages; number 1: ranges\[4\]: .* and 0\.5', output
    )
    place = next(i for i, m in enumerate(MESSAGES) if m.topic == '/episode')
    assert 'number 0: data: ' in changed(
        tmp_path / 'e', bag, place, data=cdr(make('String', data='{}'))
    )
    place = [i for i, m in enumerate(MESSAGES) if m.topic == '/flock/poses'][2]
    data = bytearray(MESSAGES[place].data)
    data[-8:] = np.float64(0.25).tobytes()
    assert 'number 2: poses[4].orientation.w: ' in changed(
        tmp_path / 'p', bag, place, data=bytes(data)
    )


def test_missing_messages_and_topics_are_counted(bag: Bag, tmp_path: Path) -> None:
    rows = [m for m in without(MESSAGES, '/goal', 1) if m.topic != '/clock']
    result = diff_bags(bag, open_bag(write(tmp_path / 'b', rows)))
    assert [str(t) for t in result.topics if not t.equal] == [
        '/clock: 10 and 0 messages', '/goal: 2 and 1 messages',
    ]  # fmt: skip
    assert result.text().endswith('different')


def test_what_is_said_again_counts_once_if_asked(bag: Bag, tmp_path: Path) -> None:
    rows = list(MESSAGES)
    for topic, padding in (('/flock/poses', b''), ('/episode', b'\0'), ('/clock', b'')):
        place = [i for i, m in enumerate(rows) if m.topic == topic][1]
        data = rows[place].data + padding  # as DDS pads what it carries
        rows.insert(place + 1, rows[place]._replace(data=data, log_ns=rows[place].log_ns + 1))
    other = open_bag(write(tmp_path / 'again', rows))
    unequal = [t.topic for t in diff_bags(bag, other).topics if not t.equal]
    assert unequal == ['/clock', '/episode', '/flock/poses']
    assert diff_bags(bag, other, once=True).equal
    assert diff_bags(other, other, once=True).text() == diff_bags(bag, bag, once=True).text()
    # what is left out, or comes back later, is no repeat
    less = open_bag(write(tmp_path / 'less', without(MESSAGES, '/flock/poses', 1)))
    assert not diff_bags(bag, less, once=True).equal
    poses = [m for m in MESSAGES if m.topic == '/flock/poses']
    late = [*MESSAGES, poses[0]._replace(log_ns=MESSAGES[-1].log_ns + 1)]
    assert not diff_bags(bag, open_bag(write(tmp_path / 'late', late)), once=True).equal


def test_log_times_count_only_if_asked(bag: Bag, tmp_path: Path) -> None:
    rows = [m._replace(log_ns=m.log_ns + (m.topic == '/goal')) for m in MESSAGES]
    other = open_bag(write(tmp_path / 'b', rows))
    assert diff_bags(bag, other).equal
    (topic,) = (t for t in diff_bags(bag, other, times=True).topics if not t.equal)
    assert (topic.topic, topic.index) == ('/goal', 0)
    assert topic.difference.startswith('log times 1700000000')


def test_types_that_cannot_be_decoded_are_compared_by_bytes(tmp_path: Path) -> None:
    bags = []
    for name, end in (('a', b'\1'), ('b', b'\2')):
        folder = write(tmp_path / name, [])
        from shepherd_ros.recordings.recording_writer import RecordingWriter

        with RecordingWriter(tmp_path / f'{name}x') as writer:
            writer.add_topic('/i', 'x_msgs/msg/X', schema=('ros2idl', b'module x'))
            writer.write('/i', b'\0\1\0\0' + end, 1, 1)
        bags.append(open_bag(tmp_path / f'{name}x'))
        assert folder.exists()
    (topic,) = diff_bags(*bags).topics
    assert topic.difference == 'bytes'


# ---- export ----


@pytest.mark.parametrize('kind', ['parquet', 'csv'])
def test_tables_hold_what_was_recorded(bag: Bag, tmp_path: Path, kind: str) -> None:
    written = export_bag(bag, tmp_path / 'out', kind)
    states = len(TRUTH)
    assert {name: table.rows for name, table in written.items()} == {
        'episodes': 2,
        'states': states * (N_SHEEP + N_SHEPHERDS),
        'scans': states * N_SHEPHERDS,
        'commands': states * N_SHEPHERDS,
    }
    read = parquet.read_table if kind == 'parquet' else csv.read_csv
    tables = {name: read(table.path).to_pydict() for name, table in written.items()}
    assert tables['episodes']['seed'] == [7, 8]
    assert tables['episodes']['whole'] == [True, True]
    assert json.loads(tables['episodes']['config'][1])['number'] == 1
    rows = tables['states']
    xy = np.array([rows['x'], rows['y']]).T.reshape(states, -1, 2)
    for place, true in zip(xy, TRUTH, strict=True):
        assert np.array_equal(place[:N_SHEEP], true.sheep)
        assert np.array_equal(place[N_SHEEP:], true.shepherds)
    assert rows['kind'][:7] == ['sheep'] * 5 + ['shepherd'] * 2
    assert rows['index'][:7] == [0, 1, 2, 3, 4, 0, 1]
    assert rows['stamp_ns'][::7] == [true.stamp_ns for true in TRUTH]
    assert set(rows['goal_x']) == {0.0}
    for k, row in enumerate(tables['scans']['goal']):
        values = row if kind == 'parquet' else [float(x) for x in row.split()]
        true = TRUTH[k // N_SHEPHERDS].scans[k % N_SHEPHERDS, 2]
        assert np.array_equal(np.float32(values), true)
    assert np.allclose(tables['commands']['x'], [x for t in TRUTH for x in t.commands[:, 0]])


def test_parts_that_were_not_recorded_are_empty_tables(tmp_path: Path) -> None:
    rows = [m for m in MESSAGES if 'shepherd_' not in m.topic]
    written = export_bag(open_bag(write(tmp_path / 'bag', rows)), tmp_path / 'out')
    assert (written['scans'].rows, written['commands'].rows) == (0, 0)
    assert parquet.read_table(written['scans'].path).column_names[-3:] == [
        'sheep',
        'shepherds',
        'goal',
    ]


def test_what_cannot_be_exported_leaves_nothing_behind(bag: Bag, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"kind is 'cvs': .*did you mean 'csv'"):
        export_bag(bag, tmp_path / 'out', 'cvs')
    export_bag(bag, tmp_path / 'out')
    with pytest.raises(BagError, match=r'episodes\.parquet: it exists already'):
        export_bag(bag, tmp_path / 'out')
    (tmp_path / 'file').write_text('')
    with pytest.raises(BagError, match='file/out: it cannot be written'):
        export_bag(bag, tmp_path / 'file' / 'out')
    foreign = [m._replace(topic='/x' + m.topic.replace('/', '_')) for m in MESSAGES]
    with pytest.raises(BagError, match='it tells of no episode'):
        export_bag(open_bag(write(tmp_path / 'bag', foreign)), tmp_path / 'none')
    assert list((tmp_path / 'none').iterdir()) == []
