"""Verbs that ask a running world, over DDS."""

from threading import Thread

from nodes.process import Graph
import pytest
from shepherd_ros.cli import main
from shepherd_ros.nodes import world_client

WORLD = {'n_sheep': 5, 'n_shepherds': 1, 'mode': 'realtime', 'rate': 50.0}


def test_a_world_is_asked_by_verbs(graph: Graph, capsys: pytest.CaptureFixture[str]) -> None:
    node = graph.host('flock_sim', '-r', '__ns:=/farm', **WORLD)

    def requested(*words: str) -> str:
        codes: list[int] = []
        thread = Thread(target=lambda: codes.append(main([*words, '--namespace', '/farm'])))
        thread.start()
        graph.until(lambda: not thread.is_alive(), ' '.join(words))
        output = capsys.readouterr()
        assert codes == [0], output.err
        return output.out

    assert requested('pause') == 'paused\n'
    assert requested('step', '3') == '3 steps, then paused\n'
    assert requested('reset', '--seed', '7') == 'episode 1, seed 7\n'
    assert requested('resume') == 'running\n'
    assert requested('goal', '5', '-3') == 'goal moves to 5, -3 m\n'
    graph.until(lambda: node.state.goal.tolist() == [5.0, -3.0], 'the goal moves')
    assert '/farm/flock_sim\n' in requested('nodes')
    output = requested('status')
    assert 'episode 1, seed 7: 5 sheep, 1 shepherds, realtime' in output
    assert 'farm/flock_sim: ' in output


def test_a_world_that_is_not_there_is_named(
    graph: Graph, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(world_client, 'DISCOVERY_TIMEOUT', 0.1)
    assert main(['pause', '--namespace', 'nowhere']) == 2
    assert 'no /nowhere/flock_sim was found within 0.1 s' in capsys.readouterr().err
