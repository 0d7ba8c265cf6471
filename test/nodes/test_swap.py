"""The controller of each shepherd is chosen by remapping topics."""

from __future__ import annotations

from nodes.process import assert_same_states, Graph, rollout
import pytest
from shepherd_ros.controllers import make_controller
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.transition import step
from shepherd_ros.sim.world import WorldConfig
import torch

STEPS = 30
WORLD = WorldConfig(n_sheep=40, episode_steps=STEPS)
SPACES = {'strombom': 'a', 'pierson': 'b'}
STATE = ('episode', 'goal', 'flock/poses', 'shepherds/poses')


def mixed(drivers: tuple[str, ...]) -> list[WorldState]:
    """Return the states of the core when each shepherd obeys its own controller."""
    state = spawn(WORLD, torch.tensor(0))
    laws = {name: make_controller(name, WORLD) for name in SPACES}
    memory = {name: law.begin(state) for name, law in laws.items()}
    states = [state]
    for _ in range(STEPS):
        output = {}
        for name, law in laws.items():
            output[name], memory[name] = law.act(state, memory[name])
        command = torch.stack([output[name][h] for h, name in enumerate(drivers)])
        state = step(state, command, WORLD)
        states.append(state)
    return states


def remap(source: str, target: str) -> list[str]:
    return ['-r', f'{source}:={target}']


def start_controllers(graph: Graph, remaps: dict[str, list[str]]) -> None:
    """Start both heuristics in their namespaces; both see the world's topics."""
    for name, space in SPACES.items():
        words = remap('__ns', f'/{space}')
        for topic in STATE:
            words += remap(topic, f'/{topic}')
        graph.host(name, *words, *remaps.get(name, []))


@pytest.mark.parametrize(
    'drivers',
    [
        ('strombom', 'pierson', 'pierson'),
        ('pierson', 'strombom', 'pierson'),
        ('pierson', 'pierson', 'pierson'),
        ('strombom', 'strombom', 'strombom'),
    ],
    ids='-'.join,
)
def test_each_shepherd_obeys_the_controller_whose_topic_is_remapped_to_it(
    graph: Graph, drivers: tuple[str, ...]
) -> None:
    remaps: dict[str, list[str]] = {name: [] for name in SPACES}
    for h, name in enumerate(drivers):
        topic = f'shepherd_{h}/cmd_vel'
        remaps[name] += remap(topic, f'/{topic}')
    track = graph.track()
    graph.host('flock_sim', n_sheep=40, episode_steps=STEPS, episodes=1)
    graph.until(lambda: track.stamps, 'the first state')
    start_controllers(graph, remaps)
    graph.until(lambda: len(track.stamps) > STEPS, 'the whole episode')
    assert_same_states(track, mixed(drivers))


def test_remapping_on_the_side_of_the_world_decides_as_well(graph: Graph) -> None:
    drivers = ('pierson', 'strombom', 'strombom')
    words = []
    for h, name in enumerate(drivers):
        words += remap(f'shepherd_{h}/cmd_vel', f'/{SPACES[name]}/shepherd_{h}/cmd_vel')
    track = graph.track()
    graph.host('flock_sim', *words, n_sheep=40, episode_steps=STEPS, episodes=1)
    graph.until(lambda: track.stamps, 'the first state')
    start_controllers(graph, {})
    graph.until(lambda: len(track.stamps) > STEPS, 'the whole episode')
    assert_same_states(track, mixed(drivers))


@pytest.mark.system
def test_two_whole_stacks_in_namespaces_do_not_hear_each_other(graph: Graph) -> None:
    spaces = {'/left': 3, '/right': 8}
    tracks = {space: graph.track(space) for space in spaces}
    for space, seed in spaces.items():
        words = remap('__ns', space)
        graph.start(
            'flock_sim', *words, n_sheep=40, episode_steps=STEPS, seed=seed, wait_for_scans=True
        )
        graph.start('lidar', *words, shepherd_ids=[0, 1, 2])
    graph.until(lambda: all(track.stamps for track in tracks.values()), 'both first states')
    for space in spaces:
        graph.start('strombom', *remap('__ns', space))
    for space, track in tracks.items():
        graph.until(lambda track=track: len(track.stamps) > STEPS, f'the whole episode of {space}')
    for space, seed in spaces.items():
        states, _ = rollout('strombom', EnvConfig(world=WORLD), seed)
        assert_same_states(tracks[space], states, tracks[space].stamps[: STEPS + 1])
    names = {name for name, _ in graph.node.get_topic_names_and_types()}
    inside = {name for name in names if name.startswith(('/left/', '/right/'))}
    everywhere = {'/clock', '/diagnostics', '/rosout', '/parameter_events'}
    assert names - inside - {'/tf'} == everywhere  # /tf only with tf2_msgs


def test_two_nodes_that_command_the_same_shepherd_are_named(graph: Graph) -> None:
    graph.listen_to_logs()
    sim = graph.host('flock_sim', n_sheep=10, n_shepherds=2)
    graph.host('pierson', shepherd_ids=[1])
    words = remap('__ns', '/b')
    for topic in (*STATE, 'shepherd_1/cmd_vel'):
        words += remap(topic, f'/{topic}')
    rival = graph.host('strombom', *words)
    graph.host('idle', shepherd_ids=[0])
    pattern = r'shepherd_1/cmd_vel is published by 2 nodes \(/b/strombom, /pierson\)'
    graph.until(lambda: graph.warnings(pattern), 'a warning that names both')
    status = graph.until_status('commands', 'several nodes command shepherd_1/cmd_vel')
    assert status.level == status.WARN
    now = sim.now_ns
    graph.until(lambda: sim.now_ns > now, 'the world goes on')
    assert len(graph.warnings('is published by')) == 1
    graph.end(rival)
    graph.until_status('commands', 'every shepherd answers')
