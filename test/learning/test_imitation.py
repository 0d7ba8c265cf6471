"""Learning from examples: from bags, from a teacher, and what is dropped on the way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.controllers import make_controller
from shepherd_ros.datasets.dataset_report import Report
from shepherd_ros.datasets.examples import (
    bag_folders,
    EpisodeExamples,
    examples_of,
)
from shepherd_ros.datasets.steps import Steps, steps_of
from shepherd_ros.learning.clone import CloneConfig, CloneLearner, Examples
from shepherd_ros.learning.dagger import LabelledWorlds
from shepherd_ros.learning.dagger_config import DaggerConfig
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.learning.train_bc import BCConfig, require_fit, stream_examples
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.recordings.episodes import iter_episodes, RecordedEpisode
from shepherd_ros.recordings.record import record_episodes
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.observation import ObservationConfig, rotate_by_ray
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import WorldConfig
import torch

STEPS, SPACING = 12, 3
WORLD = WorldConfig(n_sheep=15, n_shepherds=2, episode_steps=STEPS)
OBSERVATION = ObservationConfig(frame_interval=0.5 * SPACING, align='goal', unit=10.0)
CONFIG = PolicyConfig(
    observation=OBSERVATION, network=NetworkConfig(filters_1=8, filters_2=8, hidden=64)
)


def policy_of(config: PolicyConfig = CONFIG) -> Policy:
    torch.manual_seed(3)
    return Policy(config)


@pytest.fixture(scope='module')
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp('bags')
    record_episodes(EnvConfig(world=WORLD), make_controller('drover', WORLD), range(5, 7), out)
    return out


def episode_of(bags: Path) -> RecordedEpisode:
    return next(iter_episodes(open_bag(bags / 'episode_000005')))


def examples_in(episode: RecordedEpisode, report: Report) -> EpisodeExamples:
    steps = steps_of(episode, 'bag', 0, report.refuse)
    report.count_episode(steps)
    require_fit(steps, CONFIG)
    found = examples_of(steps, CONFIG.observation, report)
    assert found is not None
    return found


def test_examples_of_a_bag_are_what_the_environment_shows_and_the_controller_does(
    bags: Path,
) -> None:
    env = ShepherdEnv(EnvConfig(world=WORLD, observation=OBSERVATION), 1)
    law = make_controller('drover', WORLD)
    stack, _ = env.reset(5)
    memory = law.begin(env.perceived)
    report = Report()
    result = examples_in(episode_of(bags), report)
    assert len(result) == report.examples == report.steps == 2 * STEPS
    assert not report.drops
    frames = result.frames()
    for t in range(STEPS):
        command, memory = law.act(env.perceived, memory)
        assert stack is not None
        assert torch.equal(frames[2 * t : 2 * t + 2], stack[0])
        torch.testing.assert_close(result.wanted[2 * t : 2 * t + 2], command[0])
        stack, *_ = env.step(command)


def test_steps_that_are_not_whole_are_dropped_by_name(bags: Path) -> None:
    episode = episode_of(bags)
    frames = list(episode.frames)
    frames[4] = replace(frames[4], commands=[None, frames[4].commands[1]])
    frames[7] = replace(frames[7], scans=[None, frames[7].scans[1]])
    del frames[2]
    report = Report()
    result = examples_in(replace(episode, frames=frames), report)
    # nobody has a step 2, which is in the stacks of 5 and 8; shepherd 0 has no whole steps 4 and
    # 7, which are both in the stack of 10
    assert report.steps == 2 * STEPS
    assert report.drops == {
        'no poses': 2, 'no command': 1, 'no scan': 1,
        'an earlier frame is missing': 2 * 2 + 1,
    }  # fmt: skip
    assert report.first_drop == {
        'no poses': 'bag:0, step 2',
        'no command': 'bag:0, step 4, shepherd_0',
        'no scan': 'bag:0, step 7, shepherd_0',
        'an earlier frame is missing': 'bag:0, step 5, shepherd_0',
    }
    assert len(result) == report.steps - 9 == report.examples
    for words in ('no command', 'bag:0, step 4, shepherd_0', 'examples:  15'):
        assert words in report.text()


def seconds(dt: float, team: int) -> Steps:
    """Return the steps of 12 s whose scans show the time of their step [s]."""
    step, shepherd = np.divmod(np.arange(round(12 / dt) * team), team)
    lidar = np.broadcast_to((step * dt).astype(np.float32)[:, None, None], (len(step), 3, 8))
    action = np.stack([step * dt, shepherd], axis=-1).astype(np.float32)
    return Steps('bag', 0, 0, 1, team, dt, step, shepherd, lidar, action)


@pytest.mark.parametrize('dt', [0.1, 0.25, 0.3, 0.5, 1.0])
def test_frames_of_examples_are_chosen_by_time_whatever_the_time_step(dt: float) -> None:
    observation = ObservationConfig(n_frames=3, frame_interval=2.0)
    found = examples_of(seconds(dt, 2), observation, Report())
    assert found is not None
    times, newest = found.frames()[:, :, 0, 0], found.wanted[:, :1]
    apart = dt * round(2.0 / dt)  # 2.1 s where a step takes 0.3 s
    expected = (newest - apart * torch.tensor([2.0, 1.0, 0.0])).clamp(min=0.0)
    torch.testing.assert_close(times, expected, atol=1e-5, rtol=0)
    assert abs(apart - 2.0) <= dt / 2


def test_bags_that_do_not_fit_the_policy_are_refused(bags: Path, tmp_path: Path) -> None:
    few = replace(CONFIG, lidar=replace(CONFIG.lidar, n_rays=256))
    episode, report = episode_of(bags), Report()
    for lidars, output in (
        ({(75.0, 1.57)}, 'angle_min 1.57 rad, expected 0'),
        ({(75.0, 0.0), (30.0, 0.0)}, r'range_max \[30.0, 75.0\] m, expected one lidar'),
        ({(30.0, 0.0)}, 'range_max 30.0 m, expected 75.0 m'),
    ):
        frames = [replace(frame, lidars=frozenset(lidars)) for frame in episode.frames]
        with pytest.raises(ConfigError, match=output):
            require_fit(steps_of(replace(episode, frames=frames), 'bag', 0, report.refuse), CONFIG)
    with pytest.raises(ConfigError, match='scans have 512 rays, expected 256'):
        list(stream_examples([bags], policy_of(few), Report(), BCConfig()))
    with pytest.raises(ConfigError, match='expected a bag, a folder of bags'):
        bag_folders(tmp_path)


def test_bags_come_in_an_order_of_the_seed_and_all_of_them(bags: Path) -> None:
    assert [path.name for path in bag_folders(bags)] == ['episode_000005', 'episode_000006']
    orders = set()
    for seed in range(8):
        report = Report()
        rows = stream_examples([bags], policy_of(), report, BCConfig(), seed)
        sums = [float(wanted.sum()) for _, _, wanted, _ in rows]
        assert (report.bags, report.episodes) == (2, 2)
        orders.add(tuple(sums))
    assert len(orders) == 2


def test_wanted_actions_are_relative_to_the_ray_in_front(bags: Path) -> None:
    result = examples_in(episode_of(bags), Report())
    (_, first, wanted, _), _ = stream_examples([bags], policy_of(), Report(), BCConfig())
    assert (first != 0).any()
    torch.testing.assert_close(rotate_by_ray(wanted, first, 512), result.wanted, atol=1e-5, rtol=0)


def test_a_store_keeps_the_newest_examples() -> None:
    policy = policy_of()
    examples = Examples(policy, 5, torch.float32)
    frames = torch.zeros(3, 3, 3, 512)
    for start in (0, 3, 6):
        wanted = torch.arange(start, start + 3.0)[:, None].expand(3, 2)
        examples.add(frames + start, torch.arange(start, start + 3), wanted)
    assert len(examples) == 5
    assert sorted(examples.first.tolist()) == [4, 5, 6, 7, 8]
    generator = torch.Generator().manual_seed(0)
    newest = examples.draw(200, generator, newest=2)
    assert set(examples.first[newest].tolist()) == {7, 8}
    assert set(examples.first[examples.draw(200, generator)].tolist()) == {4, 5, 6, 7, 8}


def constant_fit(outlier: float, wanted: list[float]) -> tuple[float, list[float]]:
    """Return the velocity along the first ray that fits best, and the losses of 0, 0.1, .. 1."""
    policy = policy_of()
    torch.nn.init.zeros_(policy.actor.head.weight)
    examples = Examples(policy, len(wanted), torch.float32)
    along = torch.tensor([[w, 0.0] for w in wanted])
    examples.add(torch.zeros(len(wanted), 3, 3, 512), torch.zeros(len(wanted)).long(), along)
    cloner = CloneLearner(policy, CloneConfig(huber_delta=outlier), 0)
    losses = []
    for k in range(11):
        policy.actor.head.bias.data[0] = k / 10
        losses.append(float(cloner.loss(examples, torch.arange(len(wanted))).detach()))
    return min(range(11), key=losses.__getitem__) / 10, losses


def test_errors_are_squared_up_to_a_bound_by_hand() -> None:
    _, losses = constant_fit(0.5, [0.1, 1.0])
    assert losses[0] == pytest.approx((0.1**2 + 0.5 * (2 * 1.0 - 0.5)) / 2)
    assert losses[9] == pytest.approx((0.5 * (2 * 0.8 - 0.5) + 0.1**2) / 2)
    _, squares = constant_fit(1e6, [0.1, 1.0])
    assert squares[0] == pytest.approx((0.1**2 + 1.0**2) / 2)


def test_where_the_teacher_does_one_of_two_things_the_learner_does_the_usual_one() -> None:
    wanted = [0.0] * 3 + [1.0] * 7
    assert constant_fit(1e6, wanted)[0] == 0.7  # squares ask for the mean
    assert constant_fit(0.15, wanted)[0] >= 0.9


def test_the_mean_of_the_weights_by_hand() -> None:
    policy = policy_of()
    examples = Examples(policy, 8, torch.float32)
    examples.add(torch.rand(8, 3, 3, 512), torch.zeros(8).long(), torch.rand(8, 2))
    cloner = CloneLearner(policy, CloneConfig(batch_size=8, ema_decay=0.15), 0)
    seen = []
    for _ in range(3):
        cloner.train_batch(examples)
        seen.append(policy.actor.head.bias.detach().clone())
    assert not torch.equal(seen[1], seen[2])
    mean = seen[0]
    for share, new in zip((10 / 11, 0.85), seen[1:], strict=True):  # 10 / 12 is below 1 - 0.15
        mean = mean + share * (new - mean)
    given = cloner.averaged(policy_of()).actor.head.bias
    torch.testing.assert_close(given, mean)


def test_a_cloned_policy_learns_one_episode_by_heart(bags: Path) -> None:
    policy = policy_of()
    examples = Examples(policy, 100, torch.float32)
    cloner = CloneLearner(
        policy,
        CloneConfig(learning_rate=3e-3, batch_size=24, updates_per_round=150, recent_examples=24),
        0,
    )
    for row in stream_examples([bags / 'episode_000005'], policy, Report(), BCConfig()):
        examples.add(*row)
    spread = float(examples.wanted[: len(examples)].var(dim=0).sum())
    cloner.learn(examples)
    with torch.no_grad():
        left = float(cloner.loss(examples, torch.arange(len(examples))))
    assert left < 0.02 * spread


def test_a_lesson_keeps_what_the_teacher_would_do_where_the_learner_is() -> None:
    policy = policy_of()
    task = TaskConfig(sheep_min=5, sheep_max=5, shepherds_max=2, episode_steps=50, noise_max=0.4)
    config = DaggerConfig(task=task, worlds=3, groups=1, example_interval=1)
    lesson = LabelledWorlds(config, policy, 0, torch.float32)
    examples = Examples(policy, 100, torch.float32)
    start = lesson.group.moment.state
    law = make_controller('drover', lesson.group.moment.config.world)
    label, _ = law.act(start, law.begin(start))
    lesson.run(1, False, examples)
    expected = label[start.shepherd_mask]
    count = len(expected)
    result = rotate_by_ray(examples.wanted[:count], examples.first[:count], 512)
    torch.testing.assert_close(result, expected, atol=1e-5, rtol=0)
    # the learner drove
    frames = examples.frames[:count]
    action = policy.actor(policy.arrange(frames, examples.first[:count]))[0]
    moved = (lesson.group.moment.state.shepherds - start.shepherds)[start.shepherd_mask] / 0.5
    turned_action = rotate_by_ray(action, examples.first[:count], 512).detach()
    torch.testing.assert_close(moved, turned_action, atol=1e-4, rtol=0)
    # the teacher drives
    before = lesson.group.moment.state
    taught = lesson.taught
    label, _ = law.act(before, taught)
    lesson.run(1, True, examples)
    moved = (lesson.group.moment.state.shepherds - before.shepherds)[before.shepherd_mask] / 0.5
    np.testing.assert_allclose(moved, label[before.shepherd_mask], atol=1e-4)


def test_a_teacher_that_nobody_knows_is_refused() -> None:
    with pytest.raises(ConfigError, match="controller is 'nobody'"):
        DaggerConfig(teacher='nobody')
    with pytest.raises(ConfigError, match="controller is 'someone'"):
        DaggerConfig(reynolds_teacher='composite:drover,someone')
