"""The services of flock_sim, and goals that are moved by topic."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

from geometry_msgs.msg import PoseStamped
from nodes.process import assert_same_states, Graph, LATCHED, nanoseconds, Track
import pytest
from shepherd_ros.controllers import make_controller
from shepherd_ros.sim.presets import world_preset
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.transition import step
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.wire.episode import Episode
from std_msgs.msg import String
from std_srvs.srv import SetBool
import torch

SMALL: dict[str, Any] = {'n_sheep': 10, 'n_shepherds': 2}


@pytest.fixture
def sim(graph: Graph) -> Any:
    """Run a small world with shepherds that answer at once and stand still."""
    node = graph.host('flock_sim', **SMALL)
    graph.host('idle')
    graph.until(lambda: int(node.state.step) > 2, 'the world moves')
    return node


def pause(graph: Graph, on: bool) -> str:
    """Pause the world or let it go on; return what it answers."""
    answer = graph.call('flock_sim/pause', SetBool, SetBool.Request(data=on))
    assert answer.success
    return answer.message


def pose_of(x: float, y: float, frame_id: str = 'map') -> PoseStamped:
    """Return a goal as RViz publishes it."""
    message = PoseStamped()
    message.header.frame_id = frame_id
    message.pose.position.x, message.pose.position.y = x, y
    message.pose.orientation.w = 1.0
    return message


# --- reset --------------------------------------------------------------------------------------


def test_a_reset_without_seed_starts_the_next_episode(graph: Graph, sim: Any) -> None:
    first = sim.episode
    assert graph.reset() == 'episode 1, seed 1'
    assert (sim.episode.number, sim.episode.seed) == (1, 1)
    assert sim.episode.start_ns > first.start_ns
    graph.until(lambda: int(sim.state.step) > 2, 'the new episode moves')


def test_a_reset_with_a_seed_starts_that_episode_and_the_next_has_the_seed_after_it(
    graph: Graph, sim: Any
) -> None:
    pause(graph, True)
    track = graph.track()
    output = graph.collect('episode', String, LATCHED)
    assert graph.reset(41) == 'episode 1, seed 41'
    graph.until(lambda: track.stamps and sim.now_ns in track.stamps, 'the new first state')
    world = WorldConfig(**SMALL)
    fresh = spawn(world, torch.tensor(41))
    assert torch.equal(track.sheep(sim.now_ns), fresh.sheep)
    assert torch.equal(track.shepherds(sim.now_ns), fresh.shepherds)
    graph.until(
        lambda: output and Episode.from_json(output[-1].data).number == 1, 'its description'
    )
    assert Episode.from_json(output[-1].data) == sim.episode
    assert (sim.episode.seed, sim.episode.world) == (41, world.to_dict())
    assert graph.reset() == 'episode 2, seed 42'
    assert graph.reset(-5) == 'episode 3, seed -5'
    assert graph.reset(-5) == 'episode 4, seed -5'


def test_a_late_subscriber_is_told_the_running_episode_and_the_goal(
    graph: Graph, sim: Any
) -> None:
    graph.reset(9)
    output = graph.collect('episode', String, LATCHED)
    goals = graph.collect('goal', PoseStamped, LATCHED)
    graph.until(lambda: output and goals, 'episode and goal')
    assert [Episode.from_json(message.data).seed for message in output] == [9]
    assert nanoseconds(goals[0].header.stamp) == sim.episode.start_ns


# --- parameters of the next episode --------------------------------------------------------------


def test_parameters_of_the_world_hold_from_the_next_episode_on(graph: Graph, sim: Any) -> None:
    track = graph.track()
    for name, value in (
        ('n_sheep', 7), ('n_shepherds', 3), ('flock', 'reynolds'), ('goal_radius', 2.5),
        ('reynolds.fear', 12.5), ('dt', 0.25),
    ):  # fmt: skip
        assert graph.set_parameter('flock_sim', name, value) == (True, '')
    assert (sim.episode.n_sheep, sim.world.n_shepherds, sim.dt_ns) == (10, 2, 500_000_000)
    graph.reset(5)
    world = world_preset('default', 'reynolds')
    flock = replace(world.flock, fear=12.5)
    world = replace(world, n_sheep=7, n_shepherds=3, goal_radius=2.5, dt=0.25, flock=flock)
    assert (sim.episode.world, sim.episode.n_shepherds) == (world.to_dict(), 3)
    first = sim.episode.start_ns
    graph.until(lambda: track.last > first + 3 * 250_000_000, 'the new world moves')
    stamps = [ns for ns in track.stamps if ns >= first]
    assert {b - a for a, b in pairwise(stamps)} == {250_000_000}
    assert torch.equal(track.sheep(first), spawn(world, torch.tensor(5)).sheep)


def test_another_time_step_holds_from_the_next_episode_on_and_begins_only_one(
    graph: Graph,
) -> None:
    output = graph.collect('episode', String, LATCHED)
    sim = graph.host('flock_sim', n_sheep=5, n_shepherds=1, episode_steps=40, rate=4.0)
    graph.host('idle')
    graph.until(lambda: int(sim.state.step) > 2, 'the world moves')
    graph.set_parameter('flock_sim', 'dt', 0.25)
    graph.set_parameter('flock_sim', 'rate', 0.0)
    episodes: dict[int, Episode] = {}

    def received() -> bool:
        for episode in (Episode.from_json(message.data) for message in output):
            episodes[episode.number] = episode
        return 3 in episodes

    graph.until(received, 'some episodes')
    assert [episodes[k].dt for k in range(4)] == [0.5, 0.25, 0.25, 0.25]
    starts = [episodes[k].start_ns for k in range(4)]
    assert starts[2] - starts[1] == starts[3] - starts[2] == 41 * 250_000_000


def test_another_preset_changes_what_has_the_default_of_the_one_before(
    graph: Graph, sim: Any
) -> None:
    graph.set_parameter('flock_sim', 'strombom.cohesion', 2.0)
    assert graph.set_parameter('flock_sim', 'preset', 'fine_dt') == (True, '')
    assert sim.get_parameter('dt').value == 0.1
    graph.reset()
    fine = world_preset('fine_dt')
    assert sim.world.dt == 0.1
    assert sim.world.flock == replace(fine.flock, cohesion=2.0)
    graph.set_parameter('flock_sim', 'preset', 'default')
    graph.reset()
    default = world_preset('default')
    assert (sim.world.dt, sim.world.flock) == (0.5, replace(default.flock, cohesion=2.0))


# --- pause and step -----------------------------------------------------------------------------


def test_a_paused_world_stands_until_it_may_go_on(graph: Graph, sim: Any) -> None:
    track = graph.track()
    assert pause(graph, True) == 'paused'
    graph.until(lambda: sim.flock_commands.complete, 'the answers to the state that stands')
    now = sim.now_ns
    status = graph.until_status('flock_sim: episode', 'paused')
    assert status.level == status.WARN
    graph.until(lambda: track.shown.count(now) > 1, 'the state is shown again')
    assert sim.now_ns == now
    assert pause(graph, False) == 'running'
    graph.until(lambda: sim.now_ns > now + 3 * sim.dt_ns, 'it goes on')
    status = graph.until_status('flock_sim: episode', 'running')
    assert status.level == status.OK


def test_step_makes_so_many_steps_and_no_more(graph: Graph, sim: Any) -> None:
    pause(graph, True)
    assert graph.trigger('flock_sim/step') == '1 steps, then paused'
    graph.until(lambda: sim.pacing.steps_left == 0, 'one step')
    for n in (3, 1, 20):
        graph.until(lambda: sim.flock_commands.complete, 'the answers to the state that stands')
        before = sim.now_ns
        assert graph.steps(n) == f'{n} steps, then paused'
        graph.until(
            lambda goal=before + n * sim.dt_ns: sim.now_ns >= goal and sim.flock_commands.complete,
            f'{n} steps',
        )
        graph.idle(0.05)
        assert sim.now_ns == before + n * sim.dt_ns


def test_step_pauses_a_running_world(graph: Graph, sim: Any) -> None:
    graph.steps(2)
    graph.until(lambda: sim.pacing.steps_left == 0 and sim.flock_commands.complete, 'two steps')
    assert sim.pacing.paused
    now = sim.now_ns
    graph.idle(0.1)
    assert sim.now_ns == now


def test_a_world_in_realtime_can_be_paused_and_stepped_too(graph: Graph) -> None:
    sim = graph.host('flock_sim', mode='realtime', rate=100.0, **SMALL)
    graph.until(lambda: int(sim.state.step) > 3, 'steps')
    pause(graph, True)
    now = sim.now_ns
    graph.idle(0.1)
    assert sim.now_ns == now
    graph.steps(5)
    graph.until(lambda: sim.pacing.steps_left == 0, 'five steps')
    graph.idle(0.1)
    assert sim.now_ns == now + 5 * sim.dt_ns
    pause(graph, False)
    graph.until(lambda: sim.now_ns > now + 10 * sim.dt_ns, 'it goes on')


# --- goal ---------------------------------------------------------------------------------------


def test_goal_pose_moves_the_goal_of_a_paused_world_at_once(graph: Graph, sim: Any) -> None:
    pause(graph, True)
    goals = graph.collect('goal', PoseStamped, LATCHED)
    graph.publisher('goal_pose', PoseStamped).publish(pose_of(3.5, -4.0))
    graph.until(lambda: goals and goals[-1].pose.position.x == 3.5, 'the goal is told')
    assert sim.state.goal.tolist() == [3.5, -4.0]
    assert nanoseconds(goals[-1].header.stamp) == sim.now_ns
    assert goals[-1].header.frame_id == 'map'


def test_goal_pose_moves_the_goal_in_the_next_state(graph: Graph, sim: Any) -> None:
    publisher = graph.publisher('goal_pose', PoseStamped)
    goals = graph.collect('goal', PoseStamped, LATCHED)
    seen: list[tuple[int, list[float]]] = []
    original = sim.publish_state

    def publish_state(again: bool = False) -> None:
        seen.append((sim.now_ns, sim.state.goal.tolist()))
        original(again)

    sim.publish_state = publish_state
    publisher.publish(pose_of(7.0, 8.0))
    graph.until(lambda: seen and seen[-1][1] == [7.0, 8.0], 'a state with the new goal')
    graph.until(lambda: goals and goals[-1].pose.position.x == 7.0, 'the goal is told')
    first = next(ns for ns, goal in seen if goal == [7.0, 8.0])
    assert nanoseconds(goals[-1].header.stamp) == first


def test_a_reset_puts_the_goal_back_to_where_episodes_have_it(graph: Graph, sim: Any) -> None:
    graph.publisher('goal_pose', PoseStamped).publish(pose_of(7.0, 8.0))
    graph.until(lambda: sim.state.goal.tolist() == [7.0, 8.0], 'the goal moves')
    graph.reset()
    assert sim.state.goal.tolist() == [0.0, 0.0]


def run_with_a_moving_goal(
    track: Track, goals: list[PoseStamped], controller: str, world: WorldConfig
) -> list[Any]:
    """
    Return the states of the core when goals move at the stamps at which they were told.

    Shepherd 1 stands still.
    """
    moves = {nanoseconds(m.header.stamp): m.pose.position for m in goals}
    state = spawn(world, torch.tensor(0))
    law = make_controller(controller, world)
    memory = law.begin(state)
    states = []
    for ns in track.stamps:
        if ns in moves:
            state = replace(state, goal=torch.tensor([moves[ns].x, moves[ns].y]))
        states.append(state)
        command, memory = law.act(state, memory)
        command[1] = 0.0
        state = step(state, command, world)
    return states


@pytest.mark.parametrize('controller', ['strombom', 'pierson'])
def test_a_controller_sees_a_moved_goal_from_the_very_state_with_which_it_was_told(
    graph: Graph, controller: str
) -> None:
    track = graph.track()
    goals = graph.collect('goal', PoseStamped, LATCHED)
    graph.host('flock_sim', n_sheep=10, n_shepherds=2, episode_steps=200, episodes=1)
    graph.host('idle', shepherd_ids=[1])  # the world does not run away from the probe
    publisher = graph.publisher('goal_pose', PoseStamped)
    graph.until(lambda: track.stamps and goals, 'the first state and goal')
    graph.until(publisher.get_subscription_count, 'a reader of goal_pose')
    graph.host(controller, shepherd_ids=[0])
    for k in range(4):
        graph.until(lambda k=k: len(track.stamps) > 10 * k + 2, 'some steps')
        x = 5.0 * (k + 1)
        publisher.publish(pose_of(x, -8.0))
        # two goals between two states would be one, the later
        graph.until(lambda x=x: goals[-1].pose.position.x == x, f'goal at {x} m')
    graph.until(lambda: len(track.stamps) == 201, 'the whole episode')
    # the first may be told again while the controller starts
    assert len({(goal.pose.position.x, goal.pose.position.y) for goal in goals}) == 5
    world = WorldConfig(n_sheep=10, n_shepherds=2, episode_steps=200)
    assert_same_states(track, run_with_a_moving_goal(track, goals, controller, world))


@pytest.mark.parametrize(
    ('goal', 'pattern'),
    [
        (pose_of(1.0, 2.0, 'odom'), "goal_pose is in frame 'odom', expected 'map': ignored"),
        (pose_of(1.0, 2.0, ''), "goal_pose is in frame '', expected 'map'"),
        (pose_of(float('nan'), 2.0), 'goal_pose is nan, 2.0: expected finite numbers, ignored'),
        (pose_of(1.0, float('inf')), 'goal_pose is 1.0, inf: expected finite numbers, ignored'),
        (pose_of(1e39, 1.0), 'goal_pose is 1e.39, 1.0: expected finite numbers, ignored'),
    ],
    ids=['unknown frame', 'no frame', 'nan', 'infinite', 'too large for float32'],
)
def test_a_goal_pose_that_cannot_be_used_is_refused_with_a_warning(
    graph: Graph, sim: Any, goal: PoseStamped, pattern: str
) -> None:
    graph.listen_to_logs()
    publisher = graph.publisher('goal_pose', PoseStamped)
    publisher.publish(goal)
    graph.until(lambda: graph.warnings(pattern), 'a warning')
    now = sim.now_ns
    graph.until(lambda: sim.now_ns > now + 2 * sim.dt_ns, 'the world goes on')
    assert sim.state.goal.tolist() == [0.0, 0.0]


# --- values that cannot be ----------------------------------------------------------------------


def test_bad_seeds_and_numbers_of_steps_are_refused_with_a_reason_and_change_nothing(
    graph: Graph, sim: Any
) -> None:
    for name, value, pattern in (
        ('seed', 'seven', 'Wrong parameter type'),
        ('seed', 1.5, 'Wrong parameter type'),
        ('seed', True, 'Wrong parameter type'),
        ('seed', 2**63 - 1, 'seed out of range'),
        ('step_size', 0, 'step_size out of range'),
        ('step_size', -2, 'step_size out of range'),
        ('step_size', 0.5, 'Wrong parameter type'),
    ):
        taken, reason = graph.set_parameter('flock_sim', name, value)
        assert not taken
        assert pattern in reason
    assert (sim.next_seed, sim.get_parameter('step_size').value, sim.number) == (1, 1, 0)
