"""The checker finds every hole that is made into a recording, and names the first one."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
import json
from pathlib import Path

import numpy as np
import pytest
from rosbag2.tiny import (
    cdr,
    DT_NS,
    EPISODES,
    make,
    poses,
    recording,
    scan_of,
    Sent,
    STEPS,
    without,
    write,
)
from shepherd_ros.config import ConfigError
from shepherd_ros.recordings.check import check_bag
from shepherd_ros.recordings.findings import CheckResult
from shepherd_ros.recordings.recording_writer import LOST_KEY, RecordingWriter
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.wire.contract import contract_hash, topic_hashes
from shepherd_ros.wire.decode import decode_string

MESSAGES = recording()[0]
STATES = EPISODES * (STEPS + 1)
TOPICS = sorted(
    {m.topic for m in MESSAGES} - {'/clock', '/episode', '/goal', '/metrics/flock_spread'}
)


def check(folder: Path, messages: Iterable[Sent], **options: object) -> CheckResult:
    """Return what is found in a recording of messages in the order given."""
    timed = [m._replace(log_ns=k) for k, m in enumerate(messages)]
    return check_bag(open_bag(write(folder, timed)), **options)  # type: ignore[arg-type]


def test_a_whole_recording_is_ok(tmp_path: Path) -> None:
    result = check(tmp_path / 'bag', MESSAGES, require=('scans', 'commands'))
    assert result.ok
    assert (result.episodes, result.steps) == (EPISODES, STATES)
    assert (result.absent, result.unfinished) == ([], [])
    assert result.text() == '2 episodes, 10 states\nok'


def test_one_missing_message_is_one_gap(tmp_path: Path) -> None:
    for number, (topic, index) in enumerate(product(TOPICS, (0, 3, 7))):
        result = check(tmp_path / str(number), without(MESSAGES, topic, index))
        (finding,) = result.findings
        episode, step = divmod(index, STEPS + 1)
        stamp_ns = DT_NS * (1 + index)
        assert (finding.kind, finding.episode, finding.step) == ('gap', episode, step)
        assert (finding.stamp_ns, finding.topic) == (stamp_ns, topic)
        at = f'stamp {stamp_ns / 1e9:.9f}, {topic}'
        assert str(finding) == f'gap: episode {episode}, step {step}, {at}: missing'
        assert not result.ok


def test_the_first_gap_comes_first(tmp_path: Path) -> None:
    rows = without(MESSAGES, '/shepherd_1/cmd_vel', 6)
    rows = without(rows, '/flock/poses', 2)
    first, second = check(tmp_path / 'bag', rows).findings
    assert (first.topic, first.episode, first.step) == ('/flock/poses', 0, 2)
    assert (second.topic, second.episode, second.step) == ('/shepherd_1/cmd_vel', 1, 1)


def test_the_last_state_of_an_episode_needs_no_command(tmp_path: Path) -> None:
    rows = without(
        without(MESSAGES, '/shepherd_1/cmd_vel', STEPS), '/shepherd_0/cmd_vel', STATES - 1
    )
    assert check(tmp_path / 'bag', rows).ok
    assert not check(tmp_path / 'scan', without(MESSAGES, '/shepherd_0/scan/goal', STEPS)).ok


def test_the_last_episode_may_end_early(tmp_path: Path) -> None:
    for cut in range(63, len(MESSAGES), 5):
        result = check(tmp_path / str(cut), MESSAGES[:cut])
        assert result.ok, result.text()
        assert result.unfinished == ([1] if cut < len(MESSAGES) - 3 else [])


def test_an_episode_that_is_told_again_is_the_same(tmp_path: Path) -> None:
    """flock_sim tells it again to those who are silent; then it goes on."""
    for place in (5, 2 + 12, 2 + 12 * 3):  # within the first state, after it, later
        first = [message for message in MESSAGES[:3] if message.topic in ('/episode', '/goal')]
        printed = [*MESSAGES[:place], *first, *MESSAGES[place:]]
        result = check(tmp_path / f'bag_{place}', printed)
        assert result.ok, result.text()
        assert (result.episodes, result.unfinished) == (2, [])


@pytest.mark.parametrize(
    ('text', 'expected'),
    [
        ('{}', []),
        ('{"/a": 2, "/b": 1}', ['lost: /a: 2 messages', 'lost: /b: 1 messages']),
        ('[3]', ["metadata: shepherd_ros.lost is '[3]', expected numbers by topic"]),
        ('{"/a": "x"}', ['metadata: shepherd_ros.lost is']),
    ],
)
def test_what_the_recorder_missed_is_a_finding(
    tmp_path: Path, text: str, expected: list[str]
) -> None:
    folder = write(tmp_path / 'bag', MESSAGES, custom_data={LOST_KEY: text})
    findings = check_bag(open_bag(folder)).findings
    assert len(findings) == len(expected)
    for finding, words in zip(findings, expected, strict=True):
        assert str(finding).startswith(words)


def test_an_episode_that_was_begun_anew_is_unfinished(tmp_path: Path) -> None:
    """After two steps the world is told to begin again, and its stamps go on."""
    half = [i for i, m in enumerate(MESSAGES) if m.topic == '/episode'][1]
    text = json.loads(decode_string(MESSAGES[0].data))
    start = 4 * DT_NS
    text |= {'number': 1, 'start': {'sec': start // 10**9, 'nanosec': start % 10**9}}
    again = [MESSAGES[0]._replace(data=cdr(make('String', data=json.dumps(text))))]
    for message in MESSAGES[1:half]:
        stamp = int.from_bytes(message.data[4:8], 'little') * 10**9
        stamp += int.from_bytes(message.data[8:12], 'little') + start - DT_NS
        time = (stamp // 10**9).to_bytes(4, 'little') + (stamp % 10**9).to_bytes(4, 'little')
        if message.topic not in ('/clock', '/metrics/flock_spread'):
            again.append(message._replace(data=message.data[:4] + time + message.data[12:]))
    result = check(tmp_path / 'bag', [*MESSAGES[: 2 + 12 * 3], *again])
    assert result.ok, result.text()
    assert result.unfinished == [0]


def test_an_episode_in_the_middle_must_not_end_early(tmp_path: Path) -> None:
    half = [i for i, m in enumerate(MESSAGES) if m.topic == '/episode'][1]
    result = check(tmp_path / 'bag', [*MESSAGES[: half - 12], *MESSAGES[half:]])
    assert [f.kind for f in result.findings] == ['gap'] * 8
    assert {(f.episode, f.step) for f in result.findings} == {(0, STEPS)}


@pytest.mark.parametrize(('cut', 'step'), [(14, 1), (15, 1), (16, 2), (24, 2), (27, 2), (28, 3)])
def test_a_recording_that_starts_late_is_whole_from_its_first_whole_state_on(
    tmp_path: Path, cut: int, step: int
) -> None:
    """A state has 12 messages, the first of them /clock, the last a metric."""
    result = check(tmp_path / 'bag', [*MESSAGES[:2], *MESSAGES[cut:]])
    assert (result.ok, result.late, result.unfinished) == (True, {0: step}, [])
    assert f'recorded from step {step} on: episode 0\n' in result.text()
    result = check(tmp_path / 'gap', without([*MESSAGES[:2], *MESSAGES[cut:]], TOPICS[0], -6))
    assert [(f.kind, f.episode) for f in result.findings] == [('gap', 0)]


def test_a_recording_without_any_whole_state_has_gaps(tmp_path: Path) -> None:
    half = [i for i, m in enumerate(MESSAGES) if m.topic == '/episode'][1]
    rows = [m for m in MESSAGES[14:half] if m.topic != '/flock/poses']
    flock = [m for m in MESSAGES[half:] if m.topic == '/flock/poses']
    result = check(tmp_path / 'bag', [*MESSAGES[:2], *rows, *MESSAGES[half : half + 2], *flock])
    assert not result.ok
    assert not result.late


def test_what_was_never_recorded_is_absent(tmp_path: Path) -> None:
    rows = [m for m in MESSAGES if 'scan' not in m.topic]
    result = check(tmp_path / 'scans', rows)
    assert (result.ok, result.absent) == (True, ['scans'])
    assert 'not recorded: scans' in result.text()
    result = check(tmp_path / 'asked', rows, require=['scans'])
    assert [str(f) for f in result.findings] == ['absent: no scans were recorded']
    rows = [m for m in MESSAGES if 'cmd_vel' not in m.topic]
    assert check(tmp_path / 'commands', rows).absent == ['commands']
    assert not check(tmp_path / 'asked too', rows, require=['commands']).ok


def test_only_shepherds_with_a_lidar_need_scans(tmp_path: Path) -> None:
    rows = [m for m in MESSAGES if not m.topic.startswith('/shepherd_1/scan')]
    assert check(tmp_path / 'bag', rows, require=['scans']).ok
    rows = [m for m in MESSAGES if m.topic != '/shepherd_1/cmd_vel']
    assert not check(tmp_path / 'silent', rows).ok


def test_a_part_that_nobody_knows_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"require is 'scan': .*did you mean 'scans'"):
        check(tmp_path / 'bag', MESSAGES, require=['scan'])


def test_an_episode_without_a_goal_is_found(tmp_path: Path) -> None:
    (finding,) = check(tmp_path / 'bag', without(MESSAGES, '/goal', 1)).findings
    assert str(finding) == 'gap: episode 1: no goal was recorded'


def test_stamps_that_go_back_are_found(tmp_path: Path) -> None:
    places = [i for i, m in enumerate(MESSAGES) if m.topic == '/flock/poses']
    rows = list(MESSAGES)
    rows[places[1]], rows[places[2]] = rows[places[2]], rows[places[1]]
    (finding,) = check(tmp_path / 'bag', rows).findings
    assert (finding.kind, finding.step, finding.topic) == ('order', 1, 'flock/poses')


def test_stamps_between_states_and_outside_episodes_are_found(tmp_path: Path) -> None:
    extra = poses(DT_NS + 1, np.zeros((5, 2)), np.ones((5, 2)))
    beyond = poses(10**12, np.zeros((5, 2)), np.ones((5, 2)))
    place = next(i for i, m in enumerate(MESSAGES) if m.topic == '/flock/poses')
    row = MESSAGES[place]
    rows = [*MESSAGES[: place + 1], row._replace(data=extra), row._replace(data=beyond)]
    result = check(tmp_path / 'bag', [*rows, *MESSAGES[place + 1 :]])
    assert [str(f) for f in result.findings] == [
        'stray: episode 0, stamp 0.500000001, flock/poses: the stamp is that of no state',
        'stray: /flock/poses: 1 messages belong to no episode',
    ]


def test_wrong_counts_are_found(tmp_path: Path) -> None:
    place = next(i for i, m in enumerate(MESSAGES) if m.topic == '/flock/poses')
    rows = list(MESSAGES)
    few = poses(DT_NS, np.zeros((3, 2)), np.ones((3, 2)))
    rows[place] = rows[place]._replace(data=few)
    (finding,) = check(tmp_path / 'bag', rows).findings
    assert (finding.kind, finding.message) == ('count', '3 poses, expected 5')
    place = next(i for i, m in enumerate(MESSAGES) if m.topic == '/shepherd_0/scan/goal')
    rows = list(MESSAGES)
    rows[place] = rows[place]._replace(data=scan_of(DT_NS, np.zeros(8)))
    (finding,) = check(tmp_path / 'rays', rows).findings
    assert (finding.kind, finding.message) == ('count', 'channels of [8, 16] rays')


def test_types_schemas_and_contract_have_to_be_ours(tmp_path: Path) -> None:
    rows = [
        m._replace(type='std_msgs/msg/String') if m.topic == '/metrics/flock_spread' else m
        for m in MESSAGES
    ]
    (finding,) = check(tmp_path / 'type', rows).findings
    assert (finding.kind, finding.topic) == ('type', '/metrics/flock_spread')
    old = write(tmp_path / 'old', MESSAGES, custom_data={'shepherd_ros.contract': 'abc'})
    (finding,) = check_bag(open_bag(old)).findings
    assert str(finding).startswith(
        "contract: shepherd_ros.contract is 'abc', ours '" + contract_hash()[:7]
    )
    with RecordingWriter(tmp_path / 'schema') as writer:
        writer.add_topic('/clock', 'rosgraph_msgs/msg/Clock', schema=('ros2msg', b'int32 x'))
    kinds = [f.kind for f in check_bag(open_bag(tmp_path / 'schema')).findings]
    assert kinds == ['schema', 'absent']


def test_each_topic_of_a_bag_has_to_mean_the_same(tmp_path: Path) -> None:
    hashes = topic_hashes()
    missing = {name: text for name, text in hashes.items() if name != 'metrics/flock_spread'}
    cases = {
        'another topic': (hashes | {'metrics/new': 'x'}, []),
        'one that we have since': (missing, []),
        'its meaning': (hashes | {'metrics/flock_spread': 'x'}, ['/metrics/flock_spread']),
        'a meaning that is not there': (hashes | {'goal_pose': 'x'}, []),
    }
    for name, (output, wrong) in cases.items():
        data = {'shepherd_ros.contract': 'abc', 'shepherd_ros.topics': json.dumps(output)}
        found = check_bag(open_bag(write(tmp_path / name, MESSAGES, custom_data=data))).findings
        assert [(f.kind, f.topic) for f in found] == [('contract', topic) for topic in wrong]
    for text in ('[', '[1]', '7'):
        data = {'shepherd_ros.contract': 'abc', 'shepherd_ros.topics': text}
        (bad,) = check_bag(open_bag(write(tmp_path / text, MESSAGES, custom_data=data))).findings
        assert bad.kind == 'metadata'


def test_a_bag_from_before_topics_had_hashes_is_ok(tmp_path: Path) -> None:
    before = '57135bfda311c7fd6e26293ad7e9721224dca443640b9455ced35affab933188'
    bag = write(tmp_path / 'bag', MESSAGES, custom_data={'shepherd_ros.contract': before})
    assert check_bag(open_bag(bag)).ok


def test_a_bag_of_another_recorder_needs_no_hash(tmp_path: Path) -> None:
    assert check_bag(open_bag(write(tmp_path / 'bag', MESSAGES, own=False))).ok


def test_a_bag_of_others_has_no_episode(tmp_path: Path) -> None:
    rows = [m._replace(topic='/x' + m.topic.replace('/', '_')) for m in MESSAGES]
    result = check(tmp_path / 'bag', rows)
    assert [str(f) for f in result.findings] == ['absent: no episode was recorded']


def test_metadata_that_counts_otherwise_is_found(tmp_path: Path) -> None:
    folder = write(tmp_path / 'bag', MESSAGES)
    note = folder / 'metadata.yaml'
    note.write_text(note.read_text().replace('message_count: 10', 'message_count: 11', 1))
    (finding,) = check_bag(open_bag(folder)).findings
    assert str(finding) == 'metadata: 125 messages are noted, 124 are there'


def test_damage_in_the_middle_is_a_finding(tmp_path: Path) -> None:
    folder = write(tmp_path / 'bag', MESSAGES, chunk_size=4000)
    path = folder / 'bag_0.mcap'
    data = bytearray(path.read_bytes())
    data[data.index(b'shepherd_0\0') + 3] ^= 1
    path.write_bytes(data)
    result = check_bag(open_bag(folder))
    assert result.findings[-1].kind == 'damage'
    assert 'checksum is wrong' in result.text()
