"""Mistakes of users: named in words with a way out, never a traceback, never a silent stop."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import gc
import math
from pathlib import Path
import re
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from nodes.process import Graph, Process, Track, twist
import pytest
from rclpy.exceptions import ParameterException
from rclpy.publisher import Publisher
from shepherd_ros.config import ConfigError
from shepherd_ros.ros.runtime import ros_args_error
import torch

EXIT_USAGE = 2

# executable, words after --ros-args, what it has to say
REFUSED = {
    'unknown flock': ('flock_sim', '-p flock:=boids',
                      "flock is 'boids': expected one of"),
    'misspelt flock': ('flock_sim', '-p flock:=strombm', "did you mean 'strombom'"),
    'unknown preset': ('flock_sim', '-p preset:=papyrus', "preset is 'papyrus': expected one of"),
    'misspelt preset of a heuristic': ('pierson', '-p preset:=papr', "did you mean 'paper'"),
    'unknown mode': ('flock_sim', '-p mode:=fast',
                     "mode is 'fast': expected one of lockstep, realtime"),
    'unknown executor': ('flock_sim', '-p executor:=multi',
                         "executor is 'multi': expected one of events, single"),
    'negative sheep': ('flock_sim', '-p n_sheep:=-5', r'n_sheep is -5: expected .*\[1, 10000\]'),
    'no sheep': ('flock_sim', '-p n_sheep:=0', r'n_sheep is 0: expected a value in \[1, '),
    'no shepherds': ('flock_sim', '-p n_shepherds:=0', r'n_shepherds is 0: expected .*\[1, 100\]'),
    'negative steps': ('flock_sim', '-p episode_steps:=-1', r'episode_steps is -1: expected'),
    'negative episodes': ('flock_sim', '-p episodes:=-1', r'episodes is -1: expected .*\[0'),
    'nan': ('flock_sim', '-p dt:=.nan', 'dt is nan: expected a finite number, such as 0.5'),
    'infinity': ('flock_sim', '-p goal_radius:=.inf', 'goal_radius is inf: expected a finite'),
    'nan rate': ('flock_sim', '-p mode:=realtime -p rate:=.nan', 'rate is nan: expected a finite'),
    'tiny rate': ('flock_sim', '-p mode:=realtime -p rate:=1e-300',
                  'rate is 1e-300: expected 0, or at least 0.001 steps per second'),
    'text for a count': ('flock_sim', '-p n_sheep:=many',
                         r"n_sheep is 'many' \(str\): expected int, such as 100"),
    'half a sheep': ('flock_sim', '-p n_sheep:=2.5', r'n_sheep is 2.5 \(float\): expected int'),
    'text for a number': ('flock_sim', '-p dt:=fast', r"dt is 'fast' \(str\): expected float"),
    'number for a truth': ('flock_sim', '-p stamped:=1', r'stamped is 1 \(int\): expected bool'),
    'list for a count': ('flock_sim', '-p n_sheep:=[1,2]', r'n_sheep is \[1, 2\] .*expected int'),
    'huge seed': ('flock_sim', '-p seed:=9223372036854775807', 'seed is 9223.*: expected a value'),
    'number for use_sim_time': ('flock_sim', '-p use_sim_time:=5', "use_sim_time.*'5'.*BOOL"),
    'interval upside down': ('flock_sim', '-p spawn.flock_distance_min:=30.0',
                             'flock_distance_min is 30.0: expected at most .*_max, 20.0'),
    'team too small': ('flock_sim', '-p spawn.fewest_shepherds:=9',
                       'fewest_shepherds is 9: expected at most n_shepherds, 3'),
    'flock option': ('flock_sim', '-p strombom.graze_probability:=2.0',
                     r'strombom.graze_probability is 2.0: expected a value in \[0.0, 1.0\]'),
    'negative watchdog': ('flock_sim', '-p watchdog_steps:=-1', 'watchdog_steps is -1: expected'),
    'three rays': ('lidar', '-p n_rays:=3', r'n_rays is 3: expected a value in \[4, 65536\]'),
    'negative noise': ('lidar', '-p noise_std:=-1.0', r'noise_std is -1.0: expected .*\[0.0, inf'),
    'negative id': ('lidar', '-p shepherd_ids:=[-2]', r'shepherd_ids is \[-2\]: expected each'),
    'id given twice': ('lidar', '-p shepherd_ids:=[0,0]', r'shepherd_ids is \[0, 0\]: expected'),
    'one id alone': ('lidar', '-p shepherd_ids:=0',
                     r'shepherd_ids is 0 \(int\): expected list, such as \[0\]'),
    'half an id': ('lidar', '-p shepherd_ids:=[0.5]', r'\[0.5\]: expected a list of int'),
    'ids of text': ('strombom', '-p shepherd_ids:=[a]', r"\['a'\]: expected a list of int"),
    'no ids': ('strombom', '-p shepherd_ids:=[]', r'shepherd_ids is empty: .* such as \[-1\]'),
    'unknown law': ('strombom', '-p position_law:=elfiq', "did you mean 'elfiqi'"),
    'zero hold': ('random', '-p hold_steps:=0', r'hold_steps is 0: expected .*\[1, inf\]'),
    'unknown assignment': ('pierson', '-p assignment:=none', 'expected one of sorted, fixed'),
    'words without value': ('idle', '-p noise_std', "'-p noise_std'.*words after --ros-args"),
    'unknown ros argument': ('metrics', '--nonsense', "'--nonsense'.*words after --ros-args"),
    'unknown log level': ('metrics', '--log-level loud', "'--log-level loud'.*words after --ros"),
    'bad remap': ('metrics', '-r x', "'-r x'.*words after --ros-args"),
    'bad node name': ('metrics', '-r __node:=bad-name', '__node:=bad-name.*after --ros-args'),
    'list of two types': ('lidar', '-p shepherd_ids:=[1,a]', r'\[1,a\].*words after --ros-args'),
    'port too high': ('console', '-p port:=70000', r'port is 70000: expected .*\[0, 65535\]'),
    'short token': ('console', '-p token:=abc', 'token has 3 characters: expected at least 16'),
    'no host': ('console', "-p host:=''", "host is '': expected an address, such as 127.0.0.1"),
    'missing file': ('flock_sim', '--params-file /nowhere/x.yaml',
                     '/nowhere/x.yaml.*rror opening YAML file.*file of --params-file'),
}  # fmt: skip


@pytest.fixture
def refusal(shared_graph: Graph) -> Iterator[Callable[..., str]]:
    """Give what a node says, in this process, when it refuses its words after --ros-args."""

    def refused(executable: str, *words: str) -> str:
        with pytest.raises(Exception) as caught:
            shared_graph.host(executable, *words)
        if isinstance(caught.value, ConfigError | ParameterException):
            return str(caught.value)
        return ros_args_error(caught.value) or repr(caught.value)

    yield refused
    gc.collect()  # as a node that is half made keeps the logs of the next one of its name


def assert_refused(process: Process, pattern: str) -> None:
    """Assert that a process has ended as after a mistake of its user, and said why."""
    assert process.wait() == EXIT_USAGE, process
    assert re.search(pattern, process.text), process
    assert process.text.startswith(f'{process.executable}: '), process
    assert 'Traceback' not in process.text
    assert '/project/src' not in process.text  # places in the sources of rcl help nobody
    assert len(process.text.splitlines()) == 1, process


def test_a_mistake_is_named_with_a_way_out(refusal: Callable[..., str]) -> None:
    for name, (executable, words, pattern) in REFUSED.items():
        output = refusal(executable, *words.split())
        assert re.search(pattern, output), f'{name}: {output}'
        assert '/project/src' not in output


@pytest.mark.parametrize('name', ['negative sheep', 'number for use_sim_time', 'bad remap'])
def test_a_process_ends_with_the_mistake_in_one_line(shared_graph: Graph, name: str) -> None:
    executable, words, pattern = REFUSED[name]
    assert_refused(shared_graph.start(executable, *words.split()), pattern)


def test_words_that_are_not_for_ros_are_refused(shared_graph: Graph) -> None:
    for words, pattern in (
        (['n_sheep:=5'], "unknown argument 'n_sheep:=5'.*-p name:=value"),
        (['--ros-args', '-p', 'n_sheep:=5', '--', 'more'], "unknown argument 'more'"),
    ):
        assert_refused(shared_graph.start_words('flock_sim', words), pattern)


def test_a_bad_parameter_file_is_named_with_the_place(
    refusal: Callable[..., str], tmp_path: Path
) -> None:
    path = tmp_path / 'mine.yaml'
    for text, pattern in (
        ('flock_sim:\n  ros__parameters:\n    n_sheep: [1, \n', 'rror parsing a event near line'),
        ('flock_sim:\n  n_sheep: 5\n', 'Cannot have a value before ros__parameters at line 2'),
        ('n_sheep: 5\n', 'Cannot have a value before ros__parameters at line 1'),
        ('flock_sim:\n  ros__parameters:\n    n_sheep: -5\n', 'n_sheep is -5: expected'),
        ('/**:\n  ros__parameters:\n    n_sheep: few\n', "n_sheep is 'few' .*expected int"),
    ):
        path.write_text(text)
        output = refusal('flock_sim', '--params-file', str(path))
        assert re.search(pattern, output), output
        assert 'n_sheep is' in output or str(path) in output
    assert str(tmp_path) in refusal('lidar', '--params-file', str(tmp_path))


# --- mistakes with which a node can go on -------------------------------------------------------


@pytest.mark.parametrize(
    ('executable', 'words', 'pattern'),
    [
        ('flock_sim', '-p n_shep:=5', 'n_shep is not known to this node; did you mean n_sheep?'),
        ('flock_sim', '-p flock.sheep_range:=5.0', 'did you mean strombom.sheep_range?'),
        (
            'lidar',
            '-p n_ray:=64',
            'n_ray is not known to this node; did you mean n_rays?',
        ),
        ('strombom', '-p zzz:=1', 'parameter zzz is not known to this node'),
    ],
)
def test_a_misspelt_parameter_is_warned_of_with_the_nearest_name_and_the_node_runs(
    graph: Graph, executable: str, words: str, pattern: str
) -> None:
    process = graph.start(executable, *words.split())
    graph.until_says(process, r'\[WARN\].*' + re.escape(pattern))
    graph.until_status(executable, '.')
    assert process.code is None
    assert process.stop() == 0


@pytest.mark.parametrize('executable', ['lidar', 'strombom'])
def test_shepherds_that_are_not_there_are_named_and_the_others_are_served(
    graph: Graph, executable: str
) -> None:
    sim = graph.host('flock_sim', n_sheep=5, n_shepherds=2)
    process = graph.start(executable, shepherd_ids=[1, 7])
    graph.until_says(process, r'\[ERROR\].*shepherd_ids has \[7\]: expected 0 to 1')
    if executable == 'lidar':
        status = graph.until_status('lidar: lidar', 'some shepherds are not in this episode')
        assert status.level == DiagnosticStatus.ERROR
    else:
        graph.until(
            lambda: sim.flock_commands.commands.silent() == [0], 'the commands of the other'
        )
    assert process.code is None
    assert 'Traceback' not in process.text


def test_frames_with_braces_are_taken_as_they_are(graph: Graph) -> None:
    graph.host('flock_sim', n_sheep=5, n_shepherds=2)
    lidar = graph.host('lidar', scan_frame='"{k}_{h}_{"', shepherd_ids=[1])
    graph.host('idle')
    graph.until(lambda: lidar.listener.states > 3, 'scans')


def test_nodes_that_disagree_on_the_frame_say_so(graph: Graph) -> None:
    graph.listen_to_logs()
    sim = graph.host('flock_sim', n_sheep=5, frame_id='field')
    graph.host('strombom')
    pattern = "is in frame 'field', expected 'map': ignored; set parameter frame_id"
    graph.until(lambda: graph.warnings(pattern), 'a warning')
    assert int(sim.state.step) == 0


# --- commands that cannot be --------------------------------------------------------------------


@pytest.fixture
def lone(graph: Graph) -> tuple[Any, Track, Publisher]:
    """Run a world with one shepherd, which the probe commands."""
    graph.listen_to_logs()
    track = graph.track()
    sim = graph.host('flock_sim', n_sheep=5, n_shepherds=1)
    publisher = graph.publisher('shepherd_0/cmd_vel', TwistStamped)
    graph.until(lambda: track.stamps, 'the first state')
    return sim, track, publisher


def counted(graph: Graph, name: str, count: int) -> None:
    """Wait until /diagnostics has counted so many refusals."""

    def values() -> dict[str, str]:
        status = graph.status('flock_sim: commands')
        return {value.key: value.value for value in status.values} if status else {}

    graph.until(lambda: values().get(name) == str(count), f'{count} {name} on /diagnostics')


@pytest.mark.parametrize(
    'velocity',
    [(math.nan, 0.0), (0.0, math.inf), (-math.inf, math.nan), (1e39, 0.0)],
    ids=['nan', 'inf', '-inf and nan', 'beyond float32'],
)
def test_a_command_that_is_not_finite_counts_as_zero_is_warned_of_and_counted(
    graph: Graph, lone: tuple[Any, Track, Publisher], velocity: tuple[float, float]
) -> None:
    sim, track, publisher = lone
    publisher.publish(twist(track.last, *velocity))
    graph.until(lambda: len(track.stamps) == 2, 'the world goes on')
    first, second = track.stamps
    assert torch.equal(track.shepherds(first), track.shepherds(second))
    assert sim.state.sheep.isfinite().all()
    graph.until(
        lambda: graph.warnings('shepherd_0: command .* is not finite: counts as zero'), 'a warning'
    )
    counted(graph, 'not_finite', 1)


def test_a_command_in_another_frame_is_ignored_warned_of_and_counted(
    graph: Graph, lone: tuple[Any, Track, Publisher]
) -> None:
    sim, track, publisher = lone
    publisher.publish(twist(track.last, 1.0, 0.0, frame_id='base_link'))
    pattern = "shepherd_0: command in frame 'base_link', expected 'map': ignored; give velocities"
    graph.until(lambda: graph.warnings(pattern), 'a warning')
    counted(graph, 'wrong_frame', 1)
    assert int(sim.state.step) == 0
    publisher.publish(twist(track.last, 1.0, 0.0))
    graph.until(lambda: len(track.stamps) == 2, 'a good command moves the world')


@pytest.mark.parametrize('off', [-5_000_000_000, 500_000_000, 1], ids=['past', 'future', 'near'])
def test_a_command_with_another_stamp_is_ignored_warned_of_and_counted(
    graph: Graph, lone: tuple[Any, Track, Publisher], off: int
) -> None:
    sim, track, publisher = lone
    for _ in range(12):  # so that there is a past
        before = len(track.stamps)
        publisher.publish(twist(track.last, 0.0, 0.0))
        graph.until(lambda before=before: len(track.stamps) > before, 'a step')
    now = sim.now_ns
    pattern = r'command stamped (\d+\.\d{9}) s, expected 6\.500000000 s: ignored; copy the stamp'
    for count in (1, 2):
        publisher.publish(twist(now + off, 1.0, 0.0))
        graph.until(
            lambda count=count: sim.flock_commands.counts['wrong_stamp'] == count, 'it is counted'
        )
    graph.until(lambda: graph.warnings(pattern), 'a warning')
    assert re.search(pattern, graph.warnings(pattern)[0])[1] == f'{(now + off) / 1e9:.9f}'
    counted(graph, 'wrong_stamp', 2)
    assert len(graph.warnings(pattern)) == 1  # not one for each
    assert sim.now_ns == now
    publisher.publish(twist(now, 1.0, 0.0))
    graph.until(lambda: sim.now_ns > now, 'a good command moves the world')


def test_the_second_answer_to_a_state_is_counted_but_not_warned_of(
    graph: Graph, lone: tuple[Any, Track, Publisher]
) -> None:
    _, track, publisher = lone
    first = track.last
    publisher.publish(twist(first, 0.0, 0.0))
    graph.until(lambda: len(track.stamps) == 2, 'a step')
    publisher.publish(twist(first, 0.0, 0.0))
    counted(graph, 'late', 1)
    assert not graph.warnings('')


def test_a_command_faster_than_a_shepherd_is_cut_to_its_top_speed(
    graph: Graph, lone: tuple[Any, Track, Publisher]
) -> None:
    _, track, publisher = lone
    publisher.publish(twist(track.last, 30.0, 40.0))
    graph.until(lambda: len(track.stamps) == 2, 'a step')
    first, second = track.stamps
    direction = track.shepherds(second) - track.shepherds(first)
    assert torch.allclose(direction, torch.tensor([[0.3, 0.4]]), atol=1e-5)  # 1 m/s for 0.5 s
