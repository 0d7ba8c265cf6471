"""A cell of an experiment over the ROS graph is the batched one, seed for seed."""

from __future__ import annotations

from itertools import groupby

from nodes.process import Graph
import pytest
from shepherd_ros.experiments.cells import Cell, run_cell
from shepherd_ros.experiments.setting import Setting
from shepherd_ros.sim.metrics import METRICS
from std_msgs.msg import Float64

SEED, EPISODES, STEPS = 7, 3, 12


@pytest.mark.parametrize('controller', ['strombom', 'pierson', 'policy'])
def test_a_cell_over_topics_has_the_metrics_of_the_batched_one(
    graph: Graph, controller: str
) -> None:
    setting = Setting(sheep=12, shepherds=2, noise=0.3, steps=STEPS)
    name = 'policy:imitation' if controller == 'policy' else controller
    # a product of matrices may round otherwise for more rows: one world at a time for a policy
    together = 1 if controller == 'policy' else EPISODES
    cells = [Cell(setting, name, SEED + k, together) for k in range(0, EPISODES, together)]
    expected = [row for cell in cells for row in run_cell(cell).to_pylist()]

    values = {metric: graph.collect(f'metrics/{metric}', Float64) for metric in METRICS}
    graph.host('metrics')
    if controller == 'policy':
        graph.host('lidar', shepherd_ids=[0, 1], noise_std=0.3)
        graph.host('policy', shepherd_ids=[0, 1], checkpoint='imitation')
    else:
        graph.host(controller, noise_std=0.3)
    topics = [f'metrics/{metric}' for metric in METRICS]
    graph.until(lambda: all(map(graph.node.count_publishers, topics)), 'metrics')
    graph.host(
        'flock_sim', n_sheep=12, n_shepherds=2, episode_steps=STEPS, episodes=EPISODES, seed=SEED
    )

    def rows() -> list[tuple[float, ...]]:
        """Return the metrics as published; those of a state that was shown again count once."""
        received = zip(*values.values(), strict=False)
        return [key for key, _ in groupby(tuple(m.data for m in row) for row in received)]

    count = EPISODES * (STEPS + 1)
    graph.until(lambda: len(rows()) >= count, lambda: f'{len(rows())} of {count} states')
    final = rows()[STEPS :: STEPS + 1]
    assert [row['seed'] for row in expected] == [SEED + k for k in range(EPISODES)]
    for row, received in zip(expected, final, strict=True):
        assert received == tuple(row[metric] for metric in METRICS)
