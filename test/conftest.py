"""
Fixtures of all tests: threads, and for tests of nodes a DDS domain of their own.

The variables are set before rclpy and torch are imported, here and in every process of a test.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
import fcntl
from itertools import count
import os
from pathlib import Path
import signal
import tempfile
from typing import TYPE_CHECKING

from forks import forked_commands
from installed import missing_packages
from laws import compile_beside, compile_laws, wait_for_laws
import pytest
from shepherd_ros.resources import quick_profile

if TYPE_CHECKING:
    from nodes.process import Graph

FIRST, DOMAINS, SHARE = 1, 101, 25  # domains 1 to 101; a worker begins SHARE after the one before
HERE = Path(__file__).resolve().parent
PORTS = Path('/proc/net/udp')  # of this machine, where the kernel tells

os.environ |= {
    'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4',
    'OMP_NUM_THREADS': '1',
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    'ROS_PYTHON_CHECK_FIELDS': '1',
}
VARIABLE, PROFILE = quick_profile()
os.environ[VARIABLE] = str(PROFILE)
os.environ.pop('ROS_STATIC_PEERS', None)
# what a shell lets its background jobs ignore would be ignored by the nodes of the tests, too
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


LACKING = {
    str(path): names for path in HERE.rglob('test_*.py') if (names := missing_packages(path))
}
collect_ignore = [*LACKING]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name each file that was not run, as what it needs is not installed."""
    for path, names in LACKING.items():
        terminalreporter.write_line(f'not run without {", ".join(names)}: {path}')


def pytest_configure(config: pytest.Config) -> None:
    """Compile laws while workers collect tests."""
    if getattr(config.option, 'numprocesses', None) and not hasattr(config, 'workerinput'):
        compile_beside()


def pytest_collection_finish() -> None:
    """Let tests begin when the laws are compiled."""
    wait_for_laws()


_counter = count()


def participants(domain: int) -> int:
    """Return how many sockets of DDS participants of a domain are open on this machine."""
    first = 7400 + 250 * domain
    lines = PORTS.read_text().splitlines()[1:] if PORTS.exists() else []
    ports = [int(line.split()[1].rpartition(':')[2], 16) for line in lines]
    return sum(first <= port < first + 250 for port in ports)


@contextmanager
def own_domain() -> Iterator[int]:
    """Lend a domain that no other test of this machine has and in which nobody is."""
    worker = int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0').removeprefix('gw'))
    for _ in range(DOMAINS):
        domain = FIRST + (worker * SHARE + next(_counter)) % DOMAINS
        path = Path(tempfile.gettempdir(), f'shepherd_ros_domain_{domain}.lock')
        with path.open('w') as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            if participants(domain):
                continue
            yield domain
            return
    pytest.fail(f'no free ROS domain in {FIRST} to {FIRST + DOMAINS - 1}')


@contextmanager
def own_graph(folder: Path) -> Iterator[Graph]:
    """Lend an empty graph; whatever a test starts in it has ended afterwards."""
    from nodes.process import Graph

    compile_laws()
    with own_domain() as domain, pytest.MonkeyPatch.context() as patch:
        patch.setenv('ROS_DOMAIN_ID', str(domain))
        graph = Graph(domain, folder)
        try:
            others = [name for name in graph.node.get_node_names() if name != 'probe']
            assert not others, f'domain {domain} is not empty: {others}'
            yield graph
        finally:
            graph.close()


@pytest.fixture(scope='session')
def commands() -> Iterator[Path]:
    """Lend a folder with commands `shepherd` and `python` that start at once."""
    with forked_commands() as folder:
        yield folder


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[Graph]:
    """Lend an empty graph to one test."""
    with own_graph(tmp_path) as own:
        yield own


@pytest.fixture(scope='session')
def graphs() -> Callable[[Path], AbstractContextManager[Graph]]:
    """Return what lends an empty graph, for what should not meet the nodes of another run."""
    return own_graph


@pytest.fixture(scope='module')
def shared_graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    """Lend one graph to all tests of a module, which read it or clean up after themselves."""
    with own_graph(tmp_path_factory.mktemp('graph')) as own:
        yield own
