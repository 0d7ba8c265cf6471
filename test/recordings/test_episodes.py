"""Messages become episodes and frames by their stamps, whatever the order of arrival."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import json
from pathlib import Path

import numpy as np
import pytest
from rosbag2.tiny import (
    cdr,
    DT_NS,
    make,
    N_SHEEP,
    N_SHEPHERDS,
    pose,
    poses,
    RAYS,
    recording,
    scan_of,
    Sent,
    STEPS,
    Truth,
    twist,
    without,
    write,
)
from shepherd_ros.recordings.episodes import iter_episodes, RecordedEpisode
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.wire.decode import decode_string
from wire.test_episode import SENSELESS

MESSAGES, TRUTH = recording()
INFO = json.loads(decode_string(MESSAGES[0].data))


def timed(messages: Iterable[Sent]) -> list[Sent]:
    """Return messages with log times in the order given."""
    return [m._replace(log_ns=k) for k, m in enumerate(messages)]


def read(folder: Path, messages: Iterable[Sent], **options: object) -> list[RecordedEpisode]:
    """Return the episodes of messages that were recorded in the order given."""
    bag = open_bag(write(folder, timed(messages), chunk_size=4000))
    return list(iter_episodes(bag, **options))  # type: ignore[arg-type]


def check(episodes: Sequence[RecordedEpisode], truth: Sequence[Truth] = TRUTH) -> None:
    """Compare all frames with what was recorded."""
    frames = [(episode.number, frame) for episode in episodes for frame in episode.frames]
    assert len(frames) == len(truth)
    for (number, frame), true in zip(frames, truth, strict=True):
        assert (number, frame.step, frame.stamp_ns) == (true.episode, true.step, true.stamp_ns)
        assert np.array_equal(frame.sheep, true.sheep)
        assert np.array_equal(frame.shepherds, true.shepherds)
        assert np.allclose(frame.sheep_heading, true.sheep_heading, atol=1e-6)
        assert frame.shepherd_heading.tolist() == [[1.0, 0.0]] * N_SHEPHERDS
        assert np.array_equal(frame.goal, true.goal)  # type: ignore[arg-type]
        for h in range(N_SHEPHERDS):
            assert np.array_equal(frame.scans[h], true.scans[h])  # type: ignore[arg-type]
            assert np.array_equal(frame.commands[h], true.commands[h])  # type: ignore[arg-type]


def test_frames_are_what_was_recorded(tmp_path: Path) -> None:
    episodes = read(tmp_path / 'bag', MESSAGES)
    check(episodes)
    for number, episode in enumerate(episodes):
        assert (episode.number, episode.seed, episode.whole) == (number, 7 + number, True)
        assert (episode.n_sheep, episode.n_shepherds) == (N_SHEEP, N_SHEPHERDS)
        assert (episode.dt, episode.episode_steps) == (DT_NS / 1e9, STEPS)
        assert episode.world['flock']['model'] == 'strombom'
        assert episode.frames[0].scans[0].shape == (3, RAYS)  # type: ignore[union-attr]


def test_order_of_arrival_within_a_state_does_not_matter(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    per_state = 12  # messages, beside episode and goal
    for trial in range(5):
        rows = list(MESSAGES)
        start = 2
        for _ in range(2):
            for _ in range(STEPS + 1):
                part = rows[start : start + per_state]
                rows[start : start + per_state] = [part[i] for i in rng.permutation(per_state)]
                start += per_state
            start += 2
        check(read(tmp_path / str(trial), rows))


def test_an_announcement_that_is_overtaken_still_counts(tmp_path: Path) -> None:
    first, *rest = MESSAGES
    check(read(tmp_path / 'bag', [*rest[:20], first, *rest[20:]]))
    second = next(i for i, m in enumerate(rest) if m.topic == '/episode')
    late = [
        first,
        *rest[:second],
        *rest[second + 1 : second + 9],
        rest[second],
        *rest[second + 9 :],
    ]
    check(read(tmp_path / 'late', late))


def test_states_shown_again_count_once(tmp_path: Path) -> None:
    doubled = [m for message in MESSAGES for m in (message, message)]
    check(read(tmp_path / 'bag', doubled))


def test_the_first_answer_counts(tmp_path: Path) -> None:
    other = cdr(twist(9.0, 9.0))
    rows = []
    for message in MESSAGES:
        rows.append(message)
        if message.topic == '/shepherd_0/cmd_vel':
            rows.append(message._replace(data=message.data[:-48] + other[4:]))
    check(read(tmp_path / 'bag', rows))


def test_a_late_answer_finds_its_episode(tmp_path: Path) -> None:
    """The answer to the last state comes after the next episode has begun."""
    places = [i for i, m in enumerate(MESSAGES) if m.topic == '/shepherd_1/cmd_vel']
    rows = list(MESSAGES)
    rows.insert(places[STEPS] + 10, rows.pop(places[STEPS]))
    assert rows[places[STEPS]].topic == '/metrics/flock_spread'
    check(read(tmp_path / 'bag', rows))


def test_a_world_that_was_started_again_is_another_episode(tmp_path: Path) -> None:
    """Both runs have the same seed and the same stamps."""
    half = [i for i, m in enumerate(MESSAGES) if m.topic == '/episode'][1]
    run = MESSAGES[:half]
    check(read(tmp_path / 'bag', [*run, *run]), [*TRUTH[: STEPS + 1]] * 2)
    cut = run[: 2 + 12 * 3]  # three states, then started again
    check(read(tmp_path / 'cut', [*cut, *run]), [*TRUTH[:3], *TRUTH[: STEPS + 1]])


def test_plain_twists_answer_the_state_before_them(tmp_path: Path) -> None:
    rows = [
        m._replace(type='geometry_msgs/msg/Twist', data=b'\0\1\0\0' + m.data[-48:])
        if m.topic.endswith('cmd_vel')
        else m
        for m in MESSAGES
    ]
    check(read(tmp_path / 'bag', rows))


def test_the_goal_moves_with_its_stamp(tmp_path: Path) -> None:
    at = TRUTH[2].stamp_ns
    place = next(i for i, m in enumerate(MESSAGES) if m.topic == '/goal')
    moved = MESSAGES[place]._replace(data=pose(at, 3.0, 4.0))
    episodes = read(tmp_path / 'bag', [*MESSAGES[:30], moved, *MESSAGES[30:]])
    goals = [frame.goal.tolist() for frame in episodes[0].frames]  # type: ignore[union-attr]
    assert goals == [[0, 0], [0, 0], [3, 4], [3, 4], [3, 4]]


def test_what_is_missing_is_none(tmp_path: Path) -> None:
    rows = without(MESSAGES, '/shepherd_1/scan/goal', 2)
    rows = without(rows, '/shepherd_0/cmd_vel', 3)
    rows = without(rows, '/goal', 0)
    episode = read(tmp_path / 'bag', rows)[0]
    assert [frame.scans[1] is None for frame in episode.frames] == [
        False,
        False,
        True,
        False,
        False,
    ]
    assert [f.commands[0] is None for f in episode.frames] == [False, False, False, True, False]
    assert {frame.goal is None for frame in episode.frames} == {True}
    assert episode.whole


def test_states_without_poses_are_left_out(tmp_path: Path) -> None:
    episode = read(tmp_path / 'bag', without(MESSAGES, '/shepherds/poses', 1))[0]
    assert [frame.step for frame in episode.frames] == [0, 2, 3, 4]
    assert not episode.whole


def test_namespaces_are_told_apart(tmp_path: Path) -> None:
    rows = [m._replace(topic='/a' + m.topic) for m in MESSAGES if m.topic != '/clock']
    check(read(tmp_path / 'one', rows))
    both = [
        m for message in MESSAGES for m in (message, message._replace(topic='/a' + message.topic))
    ]
    with pytest.raises(BagError, match=r"namespace is None; expected one of \['/a', ''\]"):
        read(tmp_path / 'two', both)
    for namespace in ('', '/a'):
        check(list(iter_episodes(open_bag(tmp_path / 'two'), namespace)))


def test_a_scan_without_rays_and_an_empty_team_are_no_trouble(tmp_path: Path) -> None:
    rows = [
        m._replace(data=scan_of(TRUTH[0].stamp_ns, np.zeros(0)))
        if 'shepherd_0/scan' in m.topic and i < 20
        else m
        for i, m in enumerate(MESSAGES)
    ]
    episode = read(tmp_path / 'bag', rows)[0]
    assert episode.frames[0].scans[0].shape == (3, 0)  # type: ignore[union-attr]


# ---- refused in words ----


def test_wrong_counts_are_refused(tmp_path: Path) -> None:
    place = next(i for i, m in enumerate(MESSAGES) if m.topic == '/flock/poses')
    rows = list(MESSAGES)
    rows[place] = rows[place]._replace(
        data=poses(TRUTH[0].stamp_ns, np.zeros((3, 2)), np.ones((3, 2)))
    )
    with pytest.raises(
        BagError, match='episode 0, step 0: 3 sheep and 2 shepherds, expected 5 and'
    ):
        read(tmp_path / 'bag', rows)


def test_channels_of_different_sizes_are_refused(tmp_path: Path) -> None:
    place = next(i for i, m in enumerate(MESSAGES) if m.topic == '/shepherd_0/scan/goal')
    rows = list(MESSAGES)
    rows[place] = rows[place]._replace(data=scan_of(TRUTH[0].stamp_ns, np.zeros(8)))
    with pytest.raises(BagError, match=r'step 0, shepherd_0: channels of \[16, 16, 8\] rays'):
        read(tmp_path / 'bag', rows)


def test_a_wrong_type_on_a_known_topic_is_refused(tmp_path: Path) -> None:
    rows = [
        m._replace(type='std_msgs/msg/String') if m.topic == '/flock/poses' else m
        for m in MESSAGES
    ]
    with pytest.raises(
        BagError, match=r"/flock/poses .* has type 'std_msgs/msg/String', expected geo"
    ):
        read(tmp_path / 'bag', rows)


def test_a_bag_of_others_tells_of_no_episode(tmp_path: Path) -> None:
    rows = [m._replace(topic='/front' + m.topic.replace('/', '_')) for m in MESSAGES]
    with pytest.raises(BagError, match='it tells of no episode; record the topic episode too'):
        read(tmp_path / 'bag', rows)


def test_an_episode_that_makes_no_sense_is_refused(tmp_path: Path) -> None:
    for k, change in enumerate(SENSELESS):
        text = cdr(make('String', data=json.dumps({**INFO, **change})))
        with pytest.raises(BagError, match='/episode: '):
            read(tmp_path / str(k), [MESSAGES[0]._replace(data=text), *MESSAGES[1:]])
