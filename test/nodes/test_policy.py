"""The node of a learned policy: the same as in the environment, and careful with bad scans."""

from __future__ import annotations

from dataclasses import replace
import math
from typing import Any

from geometry_msgs.msg import TwistStamped
from nodes.process import assert_same_states, Graph, nanoseconds
import pytest
from sensor_msgs.msg import LaserScan
from shepherd_ros.controllers.policy_controller import LearnedConfig, LearnedController
from shepherd_ros.policy import inference
from shepherd_ros.policy.checkpoint import load_policy, save_policy
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import ObservationConfig
from shepherd_ros.sim.presets import world_preset
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.state import WorldState
import torch

STEPS = 50
CONFIG = PolicyConfig(
    decision_interval=1.0,
    lidar=LidarConfig(contact='facing'),
    observation=ObservationConfig(
        frame_interval=2.0, align='goal', unit=10.0, range_min=1.5, none_value=-1.0
    ),
    network=NetworkConfig(filters_1=8, filters_2=8, hidden=32),
)


@pytest.fixture(scope='module')
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a checkpoint whose shepherds are in lively motion."""
    torch.manual_seed(11)
    policy = Policy(CONFIG)
    policy.actor.head.weight.data *= 60.0
    path = tmp_path_factory.mktemp('policy') / 'lively.safetensors'
    save_policy(path, policy, {})
    return str(path)


def expected_states(
    checkpoint: str, episodes: int = 1, dt: float = 0.5, **options: Any
) -> list[WorldState]:
    """Return all states of episodes with seeds in a row, by env.step alone."""
    world = replace(world_preset(), episode_steps=STEPS, dt=dt)
    env = ShepherdEnv(EnvConfig(world=world), 1, lidar=False)
    law = LearnedController(LearnedConfig(checkpoint=checkpoint, **options), world)
    states = []
    for episode in range(episodes):
        env.reset(episode)
        memory = law.begin(env.perceived)
        states.append(env.state)
        for _ in range(STEPS):
            command, memory = law.act(env.perceived, memory)
            info = env.step(command)[-1]
            states.append(info.get('final_state', env.state))
    return [state.world(0) for state in states]


@pytest.mark.parametrize(('sample', 'dt'), [(False, 0.5), (True, 0.2)])
def test_fifty_steps_over_topics_are_fifty_calls_of_env_step(
    graph: Graph, checkpoint: str, sample: bool, dt: float
) -> None:
    states = expected_states(checkpoint, episodes=2, dt=dt, sample=sample)
    moved = (states[20].shepherds - states[0].shepherds).norm(dim=-1)
    assert moved.min() > 1.0
    track = graph.track()
    graph.host('flock_sim', episode_steps=STEPS, episodes=2, dt=dt)
    graph.until(lambda: track.stamps, 'the first state')
    graph.host('lidar', shepherd_ids=[0, 1, 2], contact='facing')
    graph.host('policy', shepherd_ids=[0, 1, 2], checkpoint=checkpoint, sample=sample)
    graph.until(lambda: len(track.stamps) >= len(states), f'{len(states)} states')
    assert_same_states(track, states)


def test_a_node_for_each_shepherd_drives_as_one_for_all(graph: Graph, checkpoint: str) -> None:
    states = expected_states(checkpoint, sample_std=0.2)
    track = graph.track()
    graph.host('lidar', shepherd_ids=[0, 1, 2], contact='facing')
    for h in range(3):
        graph.host(
            'policy', '-r', f'__node:=policy_{h}', shepherd_ids=[h], checkpoint=checkpoint,
            sample_std=0.2,
        )  # fmt: skip
    graph.host('flock_sim', episode_steps=STEPS, episodes=1)
    graph.until(lambda: len(track.stamps) >= len(states), f'{len(states)} states')
    # a product of matrices may round otherwise for three rows than for one; flocks are chaotic
    for ns, state in zip(track.stamps[:15], states[:15], strict=True):
        torch.testing.assert_close(track.shepherds(ns), state.shepherds, atol=1e-3, rtol=0)


class Answers:
    """Scans that are put in by hand, and what the node answers."""

    def __init__(self, graph: Graph, checkpoint: str, world: dict[str, Any], **parameters: Any):
        """Start a simulator for one shepherd, which nobody lets move, and the node."""
        self.received: list[TwistStamped] = graph.collect('shepherd_0/cmd_vel', TwistStamped)
        graph.host('policy', checkpoint=checkpoint, **parameters)
        graph.host('flock_sim', n_shepherds=1, **world)
        self.outputs = [
            graph.publisher(f'shepherd_0/scan/{channel}', LaserScan)
            for channel in ('sheep', 'shepherds', 'goal')
        ]

    def scan(self, ns: int, channel: int, ranges: list[float], range_max: float = 75.0) -> None:
        """Publish one scan."""
        pitch = 2 * math.pi / len(ranges)
        message = LaserScan(range_max=range_max, angle_increment=pitch)
        message.angle_max, message.header.frame_id = 2 * math.pi - pitch, 'shepherd_0'
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(ns, 10**9)
        message.ranges = ranges
        self.outputs[channel].publish(message)

    def speeds(self) -> list[float]:
        """Return the speeds that were commanded so far."""
        return [math.hypot(m.twist.linear.x, m.twist.linear.y) for m in self.received]


GOOD = [math.inf] * 100 + [12.0] * 30 + [math.inf] * 382


def test_a_scan_that_is_missing_nan_or_of_another_lidar_stops_the_shepherd(
    graph: Graph, checkpoint: str
) -> None:
    graph.listen_to_logs()
    answers = Answers(graph, checkpoint, {})
    cases = [
        (GOOD, 75.0, True),
        ([math.nan, *GOOD[1:]], 75.0, False),
        (GOOD, 75.0, True),
        (GOOD[:256], 75.0, False),
        (GOOD, 30.0, False),
        (GOOD, 75.0, True),
    ]
    start = 500_000_000
    for k, (ranges, range_max, fit) in enumerate(cases):
        ns = start + k * 500_000_000
        answers.scan(ns, 0, GOOD)
        # the first scan of a stamp ends the wait for the one before
        graph.until(lambda k=k: len(answers.received) == k, 'an answer to the stamp before')
        answers.scan(ns, 1, GOOD)
        answers.scan(ns, 2, ranges, range_max)
        if fit:
            graph.until(lambda k=k: len(answers.received) == k + 1, 'an answer')
        graph.idle(0.2)
    stamps = [nanoseconds(m.header.stamp) for m in answers.received]
    assert stamps == [start + k * 500_000_000 for k in range(len(cases))]
    for speed, (_, _, fit) in zip(answers.speeds(), cases, strict=True):
        assert (speed > 0.01) == fit, answers.speeds()
    status = graph.until_status('policy', 'missing or not fit')
    output = {value.key: value.value for value in status.values}
    assert (output['scans_nan'], output['scans_contract'], output['scans_missing']) == (
        '1',
        '2',
        '3',
    )
    assert float(output['latency_ms_p99']) >= float(output['latency_ms_median']) > 0
    assert graph.warnings(r'256 rays, expected 512') or graph.warnings('NaN')


@pytest.mark.parametrize('dt', [0.1, 0.05])
def test_in_real_time_decisions_are_a_second_apart_though_scans_are_lost(
    graph: Graph, checkpoint: str, dt: float
) -> None:
    policy = load_policy(checkpoint)
    timing = policy.config.timing(dt)
    second = round(1 / dt)  # steps
    # the scan of the second decision is lost: it is made at the next, and the third is in time
    steps = [1, 2, second, second + 3, second + 4, 2 * second + 1, 2 * second + 3]
    deciding = [1, second + 3, 2 * second + 1]
    answers = Answers(graph, checkpoint, {'mode': 'realtime', 'rate': 0.01, 'dt': dt})
    memory, expected = inference.begin(policy, timing, (), 1), []
    present = torch.ones(1, dtype=torch.bool)
    for k, step in enumerate(steps):
        ranges = [math.inf] * 100 + [12.0 - k] * 30 + [math.inf] * 382
        for channel in range(3):
            answers.scan(round(step * dt * 1e9), channel, ranges)
        graph.until(lambda k=k: len(answers.received) == k + 1, 'an answer')
        seen = torch.tensor(ranges).expand(1, 3, 512)
        if step in deciding:
            memory['count'].fill_(deciding.index(step) * second)
            command, memory = inference.act(
                policy, timing, lambda seen=seen: seen, present, memory, 1.0
            )
        expected.append(command[0].tolist())
    result = [[m.twist.linear.x, m.twist.linear.y] for m in answers.received]
    assert result == expected
    assert len({tuple(command) for command in result}) == len(deciding)


def test_times_that_a_step_cannot_keep_are_logged_once(graph: Graph, checkpoint: str) -> None:
    graph.listen_to_logs()
    answers = Answers(graph, checkpoint, {'dt': 0.3})
    for channel in range(3):
        answers.scan(300_000_000, channel, GOOD)
    graph.until(lambda: answers.received, 'an answer')
    output = 'decides every 0.9 s instead of 1 s, sees frames 1.8 s apart instead of 2 s'
    assert len(graph.warnings(output)) == 1
    status = graph.until_status('policy', '')
    assert {v.key: v.value for v in status.values}['decision_interval'] == '0.9'


def test_in_real_time_the_shepherds_stop_when_their_scans_do(
    graph: Graph, checkpoint: str
) -> None:
    world = {'mode': 'realtime', 'rate': 1.0}
    answers = Answers(graph, checkpoint, world, stale_after=0.5)
    for channel in range(3):
        answers.scan(500_000_000, channel, GOOD)
    graph.until(lambda: len(answers.received) == 2, 'an answer and a stop')
    assert answers.speeds()[0] > 0.01
    assert answers.speeds()[1] == 0.0
    graph.until_status('policy', 'scans have stopped')


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['-p', 'checkpoint:=none.safetensors'], 'expected a file that exists'),
        (['-p', 'checkpoint:=nobody'], 'or one that is shipped'),
        (['-p', 'shepherd_ids:=[0,0]'], r'shepherd_ids is \[0, 0\]: expected each'),
    ],
)
def test_mistakes_are_named(graph: Graph, words: list[str], message: str) -> None:
    process = graph.start_words('policy', ['--ros-args', *words])
    assert process.wait() == 2
    assert process.says(message), process
