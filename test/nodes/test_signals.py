"""Every executable ends cleanly on a signal, idle or busy, and says what it is on --help."""

from __future__ import annotations

from itertools import cycle, islice
import re
from signal import SIGHUP, SIGINT, SIGTERM
import subprocess
import sys

from nodes.process import BIN, EXECUTABLES, Graph, LATCHED, Process
import pytest
from std_msgs.msg import String

pytestmark = pytest.mark.system
LEFT = 'DDS did not let go within 10 s: left it\n'
STACK = ('flock_sim', 'lidar', 'metrics', 'strombom')


def run_python(code: str) -> subprocess.CompletedProcess[str]:
    """Return what a Python of its own did with some code."""
    words = [sys.executable, '-c', code]
    return subprocess.run(words, capture_output=True, text=True, timeout=50)


def assert_clean_end(process: Process) -> None:
    """Assert that a process ends by itself, with exit code 0 and without a traceback."""
    assert process.wait() == 0, process
    assert 'Traceback' not in process.text, process
    assert 'Error' not in process.text, process


SIGNALS = ([SIGINT], [SIGTERM], [SIGTERM, SIGTERM], [SIGINT, SIGTERM], [SIGINT, SIGINT])
EXECUTORS = ('single', 'events')


def test_every_executable_ends_with_zero_on_a_signal_while_it_waits(graph: Graph) -> None:
    waiting = [name for name in EXECUTABLES if name != 'flock_sim']
    more = {'console': {'port': 0}}
    processes = {
        name: graph.start(name, executor=executor, **more.get(name, {}))
        for name, executor in zip(waiting, cycle(EXECUTORS), strict=False)
    }
    for name in waiting:  # it reports once a second, so that it spins
        pattern = 'no (state of the world|scans) (heard|answered) yet|0 open'
        graph.until_status(f'{name}: ', pattern)
    for process, signals in zip(processes.values(), cycle(SIGNALS), strict=False):
        process.send(*signals)
    for process in processes.values():
        assert_clean_end(process)
        text = re.sub(r'\[INFO\].*: open http.*\n', '', process.text)
        assert text in ('', f'{process.executable}: {LEFT}')


@pytest.mark.parametrize('executor', EXECUTORS)
def test_a_busy_stack_ends_with_zero_on_signals_in_the_midst_of_its_work(
    graph: Graph, executor: str
) -> None:
    track = graph.track()
    parameters = {'flock_sim': {'n_sheep': 20}, 'lidar': {'shepherd_ids': [0, 1, 2]}}
    processes = [
        graph.start(name, executor=executor, **parameters.get(name, {})) for name in STACK
    ]
    graph.until_nodes(*STACK)
    graph.until(lambda: len(track.stamps) > 20, 'the world moves fast')
    first = EXECUTORS.index(executor)  # so that each node gets others than in the other run
    each = islice(cycle(SIGNALS), first, None)
    for process, signals in zip(reversed(processes), each, strict=False):
        process.send(*signals)  # the world last, so that all the others are busy
    for process in processes:
        assert_clean_end(process)


def test_the_world_ends_with_zero_in_realtime_and_while_it_waits(graph: Graph) -> None:
    fast, waiting = [], []
    for number in (SIGINT, SIGTERM, SIGHUP):
        words = ('-r', f'__ns:=/{number.name}', '-p', 'publish_clock:=false')
        track = graph.track(f'/{number.name}')
        process = graph.start('flock_sim', *words, mode='realtime', rate=500.0, n_sheep=20)
        fast.append((process, track, number))
        still = ('-r', f'__ns:=/{number.name}_waits', '-p', 'publish_clock:=false')
        waiting.append((graph.start('flock_sim', *still, n_sheep=20), number))
    for process, track, number in fast:
        graph.until(lambda track=track: len(track.stamps) > 20, 'the world moves fast')
        process.send(number)
        assert_clean_end(process)
    for process, number in waiting:
        graph.until_says(process, 'episode 0')
        process.send(number)
        assert_clean_end(process)


def test_a_freshly_started_python_ends_with_zero_on_two_signals(graph: Graph) -> None:
    # not forked, so that the end of the interpreter is part of it
    sim = graph.start('flock_sim', fresh=True, n_sheep=20)
    graph.start('strombom')
    track = graph.track()
    graph.until(lambda: len(track.stamps) > 20, 'the world moves')
    sim.send(SIGINT, SIGINT)
    assert_clean_end(sim)


def test_a_signal_that_comes_as_the_interpreter_ends_does_not_change_the_exit_code() -> None:
    code = (
        'import atexit, os, sys\n'
        'from shepherd_ros.ros.runtime import run, STOP_SIGNALS\n'
        '@atexit.register\n'
        'def last():\n'
        '    for number in STOP_SIGNALS: os.kill(os.getpid(), number)\n'
        '    os.write(1, b"sent")\n'
        "sys.argv = ['idle', 'now']\n"
        "sys.exit(run(None, 'idle', ''))\n"
    )
    child = run_python(code)
    assert (child.returncode, child.stdout) == (2, 'sent'), child.stderr


def test_a_signal_ends_a_node_whose_partner_is_stopped(graph: Graph) -> None:
    sim = graph.start('flock_sim', n_sheep=20, silence_warning=0.2)
    graph.start('strombom', shepherd_ids=[0])
    graph.until_says(sim, 'waiting at')
    assert sim.stop(SIGINT) == 0


def test_a_node_that_dds_does_not_let_go_is_left_with_its_exit_code() -> None:
    code = (
        'import time\n'
        'from shepherd_ros.ros import runtime\n'
        'class Stuck:\n'
        '    def destroy_node(self): time.sleep(60)\n'
        'runtime.DDS_SHUTDOWN_TIMEOUT = 0.1\n'
        "runtime.shut_down([Stuck()], 'lidar', 3)\n"
    )
    child = run_python(code)
    assert child.returncode == 3
    assert child.stderr == 'lidar: DDS did not let go within 0.1 s: left it\n'


def test_a_node_ends_also_where_dds_keeps_the_interpreter_to_itself() -> None:
    code = (
        'import ctypes\n'
        'from shepherd_ros.ros import runtime\n'
        'class Stuck:\n'
        '    def destroy_node(self): ctypes.PyDLL(None).sleep(60)\n'
        'runtime.DDS_SHUTDOWN_TIMEOUT = 0.1\n'
        "runtime.shut_down([Stuck()], 'lidar', 3)\n"
    )
    child = run_python(code)
    assert child.returncode == 1
    assert child.stderr.startswith('Timeout (0:00:00.2')
    assert 'in destroy_node' in child.stderr


# --- help ---------------------------------------------------------------------------------------


def test_help_names_every_parameter_with_its_default(graph: Graph) -> None:
    processes = {name: graph.start_words(name, ['--help']) for name in EXECUTABLES}
    for executable, process in processes.items():
        assert process.wait() == 0
        first, *_ = process.text.splitlines()
        assert re.match(r'[A-Z][^\n]+\.$', first), 'a sentence comes first'
        assert '--ros-args -p name:=value' in process.text
        node = graph.host(executable)
        for name in node.list_parameters([], 0).names:
            if name in ('use_sim_time', 'start_type_description_service'):
                continue
            value = node.get_parameter(name).value
            shown = list(value) if hasattr(value, 'tolist') else value
            line = re.search(
                rf'^  {re.escape(name)} \((.*?)\): (\S.+)$', process.text, re.MULTILINE
            )
            assert line, f'{name} is not in the help of {executable}'
            if not isinstance(shown, list):
                assert line[1] == str(shown), name
        graph.end(node)


def test_help_also_comes_for_a_short_h_and_beside_ros_arguments(graph: Graph) -> None:
    short = graph.start_words('idle', ['-h'])
    beside = graph.start_words('flock_sim', ['--help', '--ros-args', '-p', 'n_sheep:=7'])
    assert short.wait() == beside.wait() == 0
    assert 'noise_std (0.0)' in short.text
    assert 'n_sheep (7)' in beside.text


def test_help_into_a_closed_pipe_is_quiet(graph: Graph) -> None:
    command = f'{BIN / "lidar"} --help | head -1; exit ${{PIPESTATUS[0]}}'
    child = subprocess.run(['bash', '-c', command], capture_output=True, text=True, check=False)
    assert (child.stderr, child.returncode) == ('', 0)
    assert len(child.stdout.splitlines()) == 1


def test_help_does_not_disturb_a_running_world(graph: Graph) -> None:
    output = graph.collect('episode', String, LATCHED)
    track = graph.track()
    sim = graph.host('flock_sim', n_sheep=20, seed=5, episode_steps=100_000)
    graph.host('idle')
    graph.until(lambda: output and int(sim.state.step) > 3, 'the world runs')
    process = graph.start_words('flock_sim', ['--help'])
    graph.until(lambda: process.code is not None, 'the help')
    now = sim.now_ns
    graph.until(lambda: sim.now_ns > now + 3 * sim.dt_ns, 'the world goes on')
    assert len(output) == 1
    assert track.shown == sorted(track.shown)
