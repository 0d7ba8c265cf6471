"""Both executors: errors come out, and inputs and outputs come and go within callbacks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import time
from typing import Any

from nodes.process import DEADLINE, Graph, words_of
import pytest
from shepherd_ros.nodes.compose import NODES
from shepherd_ros.ros.node import EXECUTORS, ShepherdNode
from shepherd_ros.ros.runtime import spin


@contextmanager
def composed(graph: Graph, stack: dict[str, dict[str, Any]]) -> Iterator[list[ShepherdNode]]:
    """Give nodes of this process that no executor has."""
    nodes = [
        NODES[name](
            context=graph.context,
            cli_args=['--ros-args', *words_of(parameters)],
            use_global_arguments=False,
        )
        for name, parameters in stack.items()
    ]
    try:
        yield nodes
    finally:
        for node in nodes:
            node.destroy_node()


@pytest.mark.parametrize('executor', EXECUTORS)
def test_a_callback_that_fails_ends_the_spin_with_its_error(graph: Graph, executor: str) -> None:
    def fail() -> None:
        raise ArithmeticError('of a callback')

    end = time.monotonic() + DEADLINE
    with composed(graph, {'idle': {'executor': executor}}) as nodes:
        nodes[0].timer(0.01, fail)
        with pytest.raises(ArithmeticError, match='of a callback'):
            spin(nodes, until=lambda: time.monotonic() > end)


@pytest.mark.parametrize('executor', EXECUTORS)
def test_teams_of_varying_size_in_one_process_come_to_their_end(
    graph: Graph, executor: str
) -> None:
    stack: dict[str, dict[str, Any]] = {
        'flock_sim': {
            'executor': executor, 'n_sheep': 5, 'n_shepherds': 4, 'spawn.fewest_shepherds': 1,
            'episode_steps': 3, 'episodes': 6, 'wait_for_scans': True,
        },
        'lidar': {'shepherd_ids': [0, 1, 2, 3]},
        'pierson': {},
    }  # fmt: skip
    end = time.monotonic() + DEADLINE
    with composed(graph, stack) as nodes:
        spin(nodes, until=lambda: nodes[0].finished or time.monotonic() > end)
        assert nodes[0].finished
