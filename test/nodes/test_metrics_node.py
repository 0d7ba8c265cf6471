"""The metrics node counts what it hears, and says nothing of what it has heard in part."""

from __future__ import annotations

from collections.abc import Iterator
import math

from nodes.process import Graph
import pytest
from shepherd_ros.nodes.metrics_node import MetricsNode
from shepherd_ros.recordings.record import describe_episode
from shepherd_ros.sim.metrics import METRICS
from shepherd_ros.sim.rollout import advance, EnvConfig, Moment, start
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.world import WorldConfig
import torch

WORLD = WorldConfig(n_sheep=4, n_shepherds=2, episode_steps=6)
STILL = torch.zeros(2, 2)


def course() -> Iterator[Moment]:
    """Yield a whole episode."""
    moment = start(spawn(WORLD, torch.tensor(3)), EnvConfig(world=WORLD))
    yield moment
    for _ in range(WORLD.episode_steps):
        moment = advance(moment, STILL)
        yield moment


def received(node: MetricsNode, missed: set[int]) -> list[dict[str, float]]:
    """Return the values after each state that the node is told of."""
    moments = list(course())
    episode = describe_episode(WORLD, moments[0].state, 3)
    node.on_episode(episode, WORLD)
    values = []
    for step, moment in enumerate(moments):
        if step not in missed:
            node.on_state(episode.start_ns + step * episode.dt_ns, moment.state, episode)
            values.append(dict(node.values))
    return values


@pytest.fixture
def node(shared_graph: Graph) -> Iterator[MetricsNode]:
    """Lend a metrics node."""
    node = MetricsNode(context=shared_graph.context)
    yield node
    node.destroy_node()


def test_a_whole_episode_has_the_metrics_of_the_core(
    node: MetricsNode, capfd: pytest.CaptureFixture[str]
) -> None:
    for printed, moment in zip(received(node, set()), course(), strict=True):
        assert printed == {name: float(value) for name, value in moment.metrics().items()}
    output = capfd.readouterr().err
    assert 'episode 0, seed 3: completion_time' in output
    assert 'not whole' not in output


@pytest.mark.parametrize('missed', [{0}, {0, 1, 2}, {3}, {2, 4}])
def test_an_episode_in_part_has_only_what_a_state_tells_alone(
    node: MetricsNode, missed: set[int], capfd: pytest.CaptureFixture[str]
) -> None:
    values, truth = received(node, missed), [m.metrics() for m in course()]
    instant = {name for name, metric in METRICS.items() if metric.instant}
    assert instant == {'fraction_in_goal', 'goal_distance'}
    printed = iter(values)
    for step, true in enumerate(truth):
        if step in missed:
            continue
        row, part = next(printed), step > min(missed)
        for name, value in row.items():
            if part and name not in instant:
                assert math.isnan(value), (step, name)
            else:
                assert value == float(true[name]), (step, name)
    output = capfd.readouterr().err
    assert 'episode 0, seed 3: not whole, states are missing at ' in output
    assert 'completion_time' not in output
    values = received(node, set())  # the next one is whole again
    assert not any(math.isnan(value) for row in values for value in row.values())
