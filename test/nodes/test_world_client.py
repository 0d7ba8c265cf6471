"""Verbs that ask a running world, over DDS."""

from threading import Thread
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nodes.process import DEADLINE, Graph
import pytest
from shepherd_ros.cli import main
from shepherd_ros.config import ConfigError
from shepherd_ros.nodes import world_client
from shepherd_ros.nodes.world_client import WorldClient

REPORTS = '/diagnostics'
WORLD = {'n_sheep': 5, 'n_shepherds': 1, 'mode': 'realtime', 'rate': 50.0}


def asked(graph: Graph, *words: str) -> int:
    """Return the exit code of a verb while the graph runs."""
    codes: list[int] = []
    thread = Thread(target=lambda: codes.append(main([*words])))
    thread.start()
    graph.until(lambda: not thread.is_alive(), ' '.join(words))
    return codes[0]


def test_a_world_is_asked_by_verbs(
    graph: Graph, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(world_client, 'DISCOVERY_TIMEOUT', DEADLINE)
    node = graph.host('flock_sim', '-r', '__ns:=/farm', **WORLD)

    def requested(*words: str) -> str:
        code = asked(graph, *words, '--namespace', '/farm')
        output = capsys.readouterr()
        assert code == 0, output.err
        return output.out

    assert requested('pause') == 'paused\n'
    assert requested('step', '3') == '3 steps, then paused\n'
    assert requested('reset', '--seed', '7') == 'episode 1, seed 7\n'
    assert requested('resume') == 'running\n'
    assert requested('goal', '5', '-3') == 'goal moves to 5, -3 m\n'
    graph.until(lambda: node.state.goal.tolist() == [5.0, -3.0], 'the goal moves')
    assert requested('nodes') == '/farm/flock_sim\n/probe\n'
    episode, *reports = requested('status').splitlines()
    assert episode == 'episode 1, seed 7: 5 sheep, 1 shepherds, realtime'
    assert not [r for r in reports if ' farm/flock_sim: ' not in r]
    assert len(reports) >= 2


def scripted(
    monkeypatch: pytest.MonkeyPatch, found: dict[str, float], reports: dict[str, float]
) -> None:
    """Let nodes be found and report at these times [s]; time passes where a client spins."""
    now = 0.0

    def names(client: WorldClient) -> list[tuple[str, str]]:
        own = (client.get_name(), client.get_namespace())
        return [own, *((name, '/farm') for name, at in found.items() if at <= now)]

    def publishers(client: WorldClient, topic: str) -> list[SimpleNamespace]:
        return [SimpleNamespace(node_name=n, node_namespace=s) for n, s in names(client)[1:]]

    def spin_once(client: WorldClient, timeout_sec: float) -> None:
        nonlocal now
        now += timeout_sec
        for name, at in reports.items():
            if now - timeout_sec < at <= now:
                (subscription,) = (s for s in client.subscriptions if s.topic_name == REPORTS)
                status = DiagnosticStatus(name=f'farm/{name}: node', message=f'after {at:g} s')
                subscription.callback(DiagnosticArray(status=[status]))

    monkeypatch.setattr(world_client, 'time', SimpleNamespace(monotonic=lambda: now))
    monkeypatch.setattr(world_client.rclpy, 'spin_once', spin_once)
    monkeypatch.setattr(WorldClient, 'get_node_names_and_namespaces', names)
    monkeypatch.setattr(WorldClient, 'get_publishers_info_by_topic', publishers)


def test_nodes_are_listed_once_no_more_are_found(
    shared_graph: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    with world_client.world_client('') as client:
        for found, listed in (
            ({'a': 0.0, 'b': 9.0}, ['/farm/a']),
            ({'a': 4.8}, ['/farm/a']),
            ({'b': 1.2, 'a': 0.0, 'c': 2.4}, ['/farm/a', '/farm/b', '/farm/c']),
            ({'_hidden': 0.0, 'a': 4.8}, ['/farm/a']),
        ):
            with monkeypatch.context() as patch:
                scripted(patch, found, {})
                assert client.nodes() == listed
        scripted(monkeypatch, {'_hidden': 0.0, 'a': 5.5}, {})
        with pytest.raises(ConfigError, match=r'no node was found within 5 s: .*ROS_DOMAIN_ID'):
            client.nodes()


def test_every_node_that_publishes_diagnostics_is_awaited(
    shared_graph: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    with world_client.world_client('') as client:
        found = {'late': 0.0, 'found_late': 2.0, 'prompt': 0.0, 'silent': 2.0}
        scripted(monkeypatch, found, {'late': 4.0, 'found_late': 5.5, 'prompt': 0.5, 'silent': 99})
        assert client.status() == [
            'OK     farm/found_late: node: after 5.5 s',
            'OK     farm/late: node: after 4 s',
            'OK     farm/prompt: node: after 0.5 s',
            'STALE  farm/silent: no message of this name within 5 s',
        ]


def test_a_world_that_is_not_there_is_named(
    graph: Graph, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(world_client, 'DISCOVERY_TIMEOUT', 0.1)
    assert main(['pause', '--namespace', 'nowhere']) == 2
    assert 'no /nowhere/flock_sim was found within 0.1 s' in capsys.readouterr().err
