"""The verbs of `shepherd bag`: what they print, their exit codes, and that no bag is touched."""

from __future__ import annotations

from collections.abc import Callable
import hashlib
import json
from pathlib import Path
import re

from pyarrow import csv, parquet
import pytest
from rosbag2.tiny import (
    cdr,
    EPISODES,
    make,
    N_SHEEP,
    N_SHEPHERDS,
    recording,
    STEPS,
    tiny_bag,
    without,
    write,
)
from shepherd_ros.cli import main
from shepherd_ros.recordings.episodes import iter_episodes, RecordedEpisode
from shepherd_ros.recordings.replay import metrics_over_time, states_of
from shepherd_ros.rosbag2.diff import diff_bags
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.sim.metrics import shown
from shepherd_ros.wire.decode import decode_string

MESSAGES = recording()[0]
STATES = EPISODES * (STEPS + 1)
Said = tuple[int, str, str]


def prints(folder: Path) -> dict[str, str]:
    """Return a digest of each file in a folder."""
    return {
        str(path): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob('*'))
        if path.is_file()
    }


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Write the tiny recording."""
    return tiny_bag(tmp_path / 'bag')


@pytest.fixture
def shepherd(capsys: pytest.CaptureFixture[str]) -> Callable[..., Said]:
    """Return what runs a verb: exit code, stdout and stderr."""

    def run(*words: object) -> Said:
        code = main(['bag', *map(str, words)])
        output = capsys.readouterr()
        return code, output.out, output.err

    return run


def test_info_tells_topics_and_episodes(bag: Path, shepherd: Callable[..., Said]) -> None:
    before = prints(bag)
    code, out, err = shepherd('info', bag)
    assert (code, err) == (0, '')
    assert 'bag_0.mcap' in out
    assert f'Messages:          {len(MESSAGES)}' in out
    assert f'Topic: /flock/poses | Type: geometry_msgs/msg/PoseArray | Count: {STATES} ' in out
    assert out.count(f'States: {STEPS + 1} of {STEPS + 1} | whole') == EPISODES
    assert prints(bag) == before


def test_info_tells_the_metrics_of_each_episode(
    bag: Path, tmp_path: Path, shepherd: Callable[..., Said]
) -> None:
    lines = shepherd('info', bag)[1].splitlines()
    place = next(k for k, line in enumerate(lines) if line.startswith('Metrics: '))
    header = re.split(r'  +', lines[place])
    assert header == ['Metrics:', 'episode', 'seed', *(metric.short for metric in shown('bag'))]
    rows = [re.split(r'  +', line.strip()) for line in lines[place + 1 :]]
    assert [row[:2] for row in rows] == [['0', '7'], ['1', '8'], ['mean', 'n=2']]
    ends = []
    for row, episode in zip(rows, iter_episodes(open_bag(bag)), strict=False):
        curves = metrics_over_time(states_of(episode), episode.episode_steps)
        for printed, metric in zip(row[2:], shown('bag'), strict=True):
            name = metric.name
            late = name == 'completion_time' and not curves['completed'][-1]
            assert printed == ('never' if late else f'{curves[name][-1]:.4g}'), name
        ends.append([curves[metric.name][-1] for metric in shown('bag')])
    assert rows[2][2:] == [
        f'{(first + second) / 2:.4g}' for first, second in zip(*ends, strict=True)
    ]
    assert 'Metrics' not in shepherd('info', bag, '--no-metrics')[1]


def test_an_episode_in_part_is_marked_and_in_no_mean(
    tmp_path: Path, shepherd: Callable[..., Said]
) -> None:
    whole = shepherd('info', tiny_bag(tmp_path / 'whole'))[1].splitlines()[-3:]
    gap = write(tmp_path / 'gap', without(MESSAGES, '/flock/poses', 2))
    lines = shepherd('info', gap)[1].splitlines()[-2:]  # one whole episode has no mean
    assert lines[0].split()[:2] == ['0', '7']
    assert lines[0].split()[2:8] == ['-'] * len(shown('bag'))
    assert lines[0].endswith('not whole: 1 of 5 missing')
    assert lines[1].split() == whole[1].split()
    last = STATES - 1  # the state in which the second episode is over
    cut = write(tmp_path / 'cut', without(MESSAGES, '/flock/poses', last))
    lines = shepherd('info', cut)[1].splitlines()[-2:]
    assert lines[0].split() == whole[0].split()
    assert '-' not in lines[1].split()
    assert lines[1].endswith(f'not whole: until step {STEPS - 1}')


def test_info_is_also_json(tmp_path: Path, shepherd: Callable[..., Said]) -> None:
    tiny_bag(tmp_path / 'bags' / 'whole')
    write(tmp_path / 'bags' / 'gap', without(MESSAGES, '/flock/poses', 2))
    found = json.loads(shepherd('info', tmp_path / 'bags', '--json')[1])
    assert found['unreadable'] == {}
    whole, gap = found['bags']['whole'], found['bags']['gap']
    assert whole == json.loads(shepherd('info', tmp_path / 'bags' / 'whole', '--json')[1])
    assert (whole['messages'], gap['messages']) == (len(MESSAGES), len(MESSAGES) - 1)
    assert whole['start_ns'] == MESSAGES[0].log_ns
    counts = {topic['name']: topic['count'] for topic in whole['topics']}
    assert counts['/flock/poses'] == STATES
    assert [(e['seed'], e['whole'], e['states']) for e in gap['episodes']] == [
        (7, False, STEPS),
        (8, True, STEPS + 1),
    ]
    assert gap['episodes'][0]['metrics'] == {}  # which are not those of a whole episode
    assert gap['episodes'][1] == whole['episodes'][1]
    ends = [curve_ends(episode) for episode in iter_episodes(open_bag(tmp_path / 'bags/whole'))]
    for episode, end in zip(whole['episodes'], ends, strict=True):
        printed = episode['metrics']
        assert printed['fraction_in_goal'] == end['fraction_in_goal']
        assert printed['completion_time'] in (end['completion_time'], None)


def test_info_of_a_folder_lists_its_bags(tmp_path: Path, shepherd: Callable[..., Said]) -> None:
    folder = tmp_path / 'bags'
    folder.mkdir()
    first = tiny_bag(folder / 'first')
    write(folder / 'second', without(MESSAGES, '/flock/poses', 2))
    (folder / '.killed').mkdir()
    code, out, err = shepherd('info', folder)
    assert (code, err) == (0, '')
    lines = [re.split(r'  +', line.strip()) for line in out.splitlines()]
    assert lines[0] == ['Bag', 'Duration [s]', 'Messages', 'Size', 'Episodes', 'Seeds']
    assert lines[1][:3] == ['first', '0.1', str(len(MESSAGES))]
    assert lines[1][4:] == [str(EPISODES), '7, 8']
    assert lines[2][4:] == [str(EPISODES), '7, 8', '1 not whole']
    assert f'2 bags, 4 episodes, 3 whole; {2 * len(MESSAGES) - 1} messages, ' in out
    ends = [curve_ends(episode) for episode in iter_episodes(open_bag(first))]
    ends.append(ends[1])  # the whole one of the second bag
    assert out.splitlines()[-len(shown('bag')) - 1].startswith('Mean over 3 whole episodes')
    for line, metric in zip(lines[-len(shown('bag')) :], shown('bag'), strict=True):
        mean = sum(end[metric.name] for end in ends) / 3
        assert line == [metric.short, f'{mean:.4g}']
    (folder / 'second' / 'second_0.mcap').write_bytes(b'no bag')
    code, out, err = shepherd('info', folder, '--no-metrics')
    assert (code, err) == (1, '')
    assert f'second  {folder / "second" / "second_0.mcap"}: ' in out
    assert '1 bag, 2 episodes, 2 whole; ' in out
    assert '1 bag cannot be read' in out
    assert 'Mean' not in out


def curve_ends(episode: RecordedEpisode) -> dict[str, float]:
    """Return the metrics of an episode at its end."""
    curves = metrics_over_time(states_of(episode), episode.episode_steps)
    return {name: float(values[-1]) for name, values in curves.items()}


def test_info_of_states_that_cannot_be_counted_has_no_metrics_for_them(
    tmp_path: Path, shepherd: Callable[..., Said]
) -> None:
    text = {
        '"n_sheep": 5, "n_shepherds"': '"n_sheep": 6, "n_shepherds"',
        '"goal_radius": 4.0, "m': '"m',
    }
    columns = len(shown('bag'))
    for k, (old, new) in enumerate(text.items()):
        rows = []
        for m in MESSAGES:
            if m.topic == '/episode':
                output = decode_string(m.data)
                assert old in output
                m = m._replace(data=cdr(make('String', data=output.replace(old, new))))
            rows.append(m)
        code, out, err = shepherd('info', write(tmp_path / str(k), rows))
        assert (code, err) == (0, '')
        assert [line.split()[2:] for line in out.splitlines()[-2:]] == [['?'] * columns] * 2


def test_check_of_a_whole_bag_is_zero_and_of_a_gap_one(
    bag: Path, tmp_path: Path, shepherd: Callable[..., Said]
) -> None:
    code, out, err = shepherd('check', bag, '--require', 'scans', 'commands')
    assert (code, err) == (0, '')
    assert out == f'{EPISODES} episodes, {STATES} states\nok\n'
    holed = write(tmp_path / 'holed', without(MESSAGES, '/flock/poses', 2))
    before = prints(holed)
    code, out, _ = shepherd('check', holed)
    assert code == 1
    assert 'gap: episode 0, step 2' in out
    assert out.endswith('not ok\n')
    assert prints(holed) == before


def test_check_requires_parts(tmp_path: Path, shepherd: Callable[..., Said]) -> None:
    rows = [message for message in MESSAGES if '/scan/' not in message.topic]
    blind = write(tmp_path / 'blind', rows)
    assert shepherd('check', blind)[0] == 0
    code, out, _ = shepherd('check', blind, '--require', 'scans')
    assert code == 1
    assert 'no scans were recorded' in out


def test_recover_makes_a_new_bag_beside_the_torn_one(
    tmp_path: Path, shepherd: Callable[..., Said]
) -> None:
    whole = tiny_bag(tmp_path / 'whole', chunk_size=4096)
    torn = tiny_bag(tmp_path / 'torn', chunk_size=4096)
    (torn / 'metadata.yaml').unlink()
    file = torn / 'torn_0.mcap'
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    before = prints(torn)
    assert shepherd('info', torn)[0] == 2
    code, out, err = shepherd('recover', torn)
    assert (code, err) == (0, '')
    assert 'messages kept of 1 files' in out
    assert prints(torn) == before
    stored = [m.data for m in open_bag(tmp_path / 'torn_recovered').messages()]
    assert stored == [m.data for m in open_bag(whole).messages()][: len(stored)]
    assert 0 < len(stored) < len(MESSAGES)
    code, _, err = shepherd('recover', torn)
    assert code == 2
    assert 'it exists already; choose another folder' in err


@pytest.mark.parametrize('compression', ['none', 'zstd', 'lz4'])
def test_recover_of_a_whole_bag_loses_nothing(
    bag: Path, tmp_path: Path, shepherd: Callable[..., Said], compression: str
) -> None:
    words = ['recover', bag, '-o', tmp_path / 'new', '--compression', compression]
    assert shepherd(*words)[0] == 0
    assert diff_bags(open_bag(bag), open_bag(tmp_path / 'new'), times=True).equal
    code, out, _ = shepherd('diff', bag, tmp_path / 'new', '--times')
    assert code == 0
    assert out.endswith('\nequal\n')


@pytest.mark.parametrize('kind', ['parquet', 'csv'])
def test_export_writes_tables(
    bag: Path, tmp_path: Path, shepherd: Callable[..., Said], kind: str
) -> None:
    before, folder = prints(bag), tmp_path / 'tables'
    code, out, err = shepherd('export', bag, '-o', folder, '--format', kind)
    assert (code, err) == (0, '')
    read = parquet.read_table if kind == 'parquet' else csv.read_csv
    rows = {
        'episodes': EPISODES,
        'states': STATES * (N_SHEEP + N_SHEPHERDS),
        'scans': STATES * N_SHEPHERDS,
        'commands': STATES * N_SHEPHERDS,
    }
    for name, count in rows.items():
        assert f'{folder / name}.{kind}: {count} rows' in out
        assert read(folder / f'{name}.{kind}').num_rows == count
    assert prints(bag) == before
    code, _, err = shepherd('export', bag, '-o', folder, '--format', kind)
    assert code == 2
    assert 'it exists already' in err


def test_export_names_the_namespaces(
    bag: Path, tmp_path: Path, shepherd: Callable[..., Said]
) -> None:
    code, _, err = shepherd('export', bag, '-o', tmp_path / 'tables', '--namespace', '/farm')
    assert code == 2
    assert "namespace is '/farm'; expected one of ['']" in err
    assert 'Traceback' not in err


def test_diff_names_the_first_difference(
    bag: Path, tmp_path: Path, shepherd: Callable[..., Said]
) -> None:
    assert shepherd('diff', bag, bag)[0] == 0
    other = write(tmp_path / 'other', without(MESSAGES, '/shepherd_1/cmd_vel', 1))
    code, out, _ = shepherd('diff', bag, other)
    assert code == 1
    assert f'/shepherd_1/cmd_vel: {STATES} and {STATES - 1} messages; number 1: ' in out
    assert f'/flock/poses: {STATES} equal messages' in out
    assert out.endswith('\ndifferent\n')
    later = [m._replace(log_ns=m.log_ns + 1) for m in MESSAGES]
    moved = write(tmp_path / 'moved', later)
    assert shepherd('diff', bag, moved)[0] == 0
    assert shepherd('diff', bag, moved, '--times')[0] == 1


@pytest.mark.parametrize('verb', ['info', 'check', 'recover', 'export', 'diff'])
@pytest.mark.parametrize('kind', ['missing', 'empty file', 'empty folder', 'text'])
def test_what_is_no_bag_is_two_and_one_line(
    bag: Path, tmp_path: Path, shepherd: Callable[..., Said], verb: str, kind: str
) -> None:
    path = tmp_path / 'none.mcap'
    if kind == 'empty folder':
        path.mkdir()
    elif kind != 'missing':
        path.write_text('' if kind == 'empty file' else 'no bag at all\n' * 100)
    before = prints(tmp_path)
    more = {'export': ['-o', tmp_path / 'tables'], 'diff': [bag]}.get(verb, [])
    code, out, err = shepherd(verb, path, *more)
    assert (code, out) == (2, '')
    assert err.startswith(f'shepherd: {path}: ')
    assert '; ' in err
    assert err.count('\n') == 1
    assert prints(tmp_path) == before


def test_unknown_words_are_two() -> None:
    for words in (['bag', 'burn'], ['bag', 'info'], ['bag', 'check', 'x', '--require', 'wool']):
        with pytest.raises(SystemExit) as stop:
            main(words)
        assert stop.value.code == 2
