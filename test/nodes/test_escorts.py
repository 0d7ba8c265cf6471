"""Payload protection over topics: what env.step does, to the end, and what a bag of it says."""

from __future__ import annotations

from dataclasses import replace

from nodes.process import assert_same_states, Graph, LATCHED
import pytest
from shepherd_ros.controllers import make_controller
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.metrics import METRICS
from shepherd_ros.sim.presets import world_preset
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.state import WorldState
from shepherd_ros.wire.episode import Episode
from std_msgs.msg import Float64, String

WORLD = replace(world_preset(task='protection'), n_shepherds=2, n_sheep=30, episode_steps=400)


def rollout(controller: str, seed: int) -> tuple[list[WorldState], dict[str, float]]:
    """Return the states of an episode until its end, and its metrics, by env.step alone."""
    env, law = (
        ShepherdEnv(EnvConfig(world=WORLD), 1, lidar=False),
        make_controller(controller, WORLD),
    )
    env.reset(seed)
    states, memory = [env.state.world(0)], law.begin(env.perceived)
    while True:
        command, memory = law.act(env.perceived, memory)
        _, _, terminated, _, info = env.step(command)
        states.append(info.get('final_state', env.state).world(0))
        if terminated:
            return states, {k: float(v[0]) for k, v in info['final_metrics'].items()}


@pytest.mark.parametrize(('controller', 'seed'), [('block', 1), ('ring', 3)])
def test_episodes_over_topics_end_where_those_of_env_step_do(
    graph: Graph, controller: str, seed: int
) -> None:
    states, expected = rollout(controller, seed)
    ends = graph.collect('episode', String, LATCHED)
    values = {name: graph.collect(f'metrics/{name}', Float64) for name in WORLD.task.metrics}
    track = graph.track()
    graph.host('metrics')
    graph.until(lambda: graph.node.count_publishers(f'metrics/{next(iter(METRICS))}'), 'metrics')
    graph.host(
        'flock_sim', task='protection', n_sheep=30, n_shepherds=2, episode_steps=400,
        seed=seed, episodes=1,
    )  # fmt: skip
    graph.until(
        lambda: all(map(graph.node.count_publishers, (f'metrics/{n}' for n in values))),
        'the metrics of protection',
    )
    graph.host('controller', controller=controller)
    graph.until(lambda: len(track.stamps) >= len(states), f'{len(states)} states')
    assert_same_states(track, states)
    graph.until(lambda: Episode.from_json(ends[-1].data).end, 'the end')
    episode = Episode.from_json(ends[-1].data)
    assert (episode.end, episode.task, episode.number) == ('terminated', 'protection', 0)
    assert episode == Episode.from_json(ends[0].data)
    last = {'steps_survived': float(len(states) - 1)}
    graph.until(
        lambda: all(values[n] and values[n][-1].data == v for n, v in (expected | last).items()),
        'the metrics at the end',
    )
