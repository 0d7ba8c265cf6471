"""Progress of long work: on stderr only, a bar on a terminal, few lines elsewhere."""

from __future__ import annotations

from pathlib import Path
import re
import sys

import pytest
from rosbag2.tiny import recording, tiny_bag
from shepherd_ros.cli import progress as shown
from shepherd_ros.cli.progress import progress, reading
from shepherd_ros.datasets.examples import count_examples
from shepherd_ros.recordings.check import check_bag
from shepherd_ros.recordings.recording_writer import recover_recording
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.sim.observation import ObservationConfig


def test_a_pipe_gets_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 0.0
    monkeypatch.setattr('time.monotonic', lambda: now)
    with progress('counting', 200) as show:
        for done in range(200):
            now = done * 0.5  # [s], 100 in all
            show(done, text=f'at {done}')
    printed = capsys.readouterr()
    assert printed.out == ''
    assert printed.err == 'counting: 30% at 60\ncounting: 60% at 120\ncounting: 90% at 180\n'


def test_a_terminal_gets_a_bar_that_leaves_stdout_alone(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, 'isatty', lambda: True)
    monkeypatch.setenv('TERM', 'xterm')
    monkeypatch.delenv('NO_COLOR', raising=False)
    with progress('counting', 4) as show:
        print('a result')
        show(3, text='of four')
    printed = capsys.readouterr()
    assert printed.out == 'a result\n'
    assert 'counting of four' in printed.err
    assert '75%' in printed.err
    with progress('counting', 4, quiet=True) as show:
        show(3)
    assert capsys.readouterr().err == ''


def test_reading_goes_from_the_start_of_a_bag_to_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shown, 'LINE_PERIOD', 0.0)
    bag = open_bag(tiny_bag(tmp_path / 'bag', chunk_size=2048))
    with reading(bag):
        check_bag(bag)
    lines = capsys.readouterr().err.splitlines()
    shares = [int(re.fullmatch(r'reading: (\d+)% bag, 0 of 0 s', line)[1]) for line in lines]  # type: ignore[index]
    assert shares[0] == 0
    assert max(shares) > 80
    assert len(set(shares)) > 5


def test_data_sets_tell_which_bag_is_next(tmp_path: Path) -> None:
    bags = [tiny_bag(tmp_path / name) for name in 'abc']
    output: list[tuple[int, int]] = []
    frames = ObservationConfig(n_frames=2, frame_interval=0.5)
    count_examples(bags, frames, on_bag=lambda done, total: output.append((done, total)))
    assert output == [(0, 3), (1, 3), (2, 3)]


def test_recovering_tells_how_many_messages_it_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('shepherd_ros.recordings.recording_writer.PROGRESS_STEP', 50)
    output: list[int] = []
    recover_recording(tiny_bag(tmp_path / 'bag'), on_progress=output.append)
    assert output == list(range(50, len(recording()[0]) + 1, 50))
