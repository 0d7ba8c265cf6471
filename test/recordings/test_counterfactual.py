"""From any state of a bag on: the same law makes the same future, another law another one."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image
import pytest
from rosbag2.tiny import Sent, write
from shepherd_ros.cli import main
from shepherd_ros.controllers import make_controller
from shepherd_ros.recordings.check import check_bag
from shepherd_ros.recordings.counterfactual import metrics_table, record_future
from shepherd_ros.recordings.episodes import iter_episodes, RecordedEpisode
from shepherd_ros.recordings.record import episode_folder, record_episodes
from shepherd_ros.rosbag2.diff import diff_bags
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.presets import world_preset
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.wire.encode import encode_goal

STEPS = 20
LIDAR = LidarConfig(n_rays=32)
Said = tuple[int, str, str]


def world(flock: str = 'strombom') -> WorldConfig:
    """Return a small world."""
    return replace(world_preset('default', flock), n_sheep=20, n_shepherds=2, episode_steps=STEPS)


def recorded(folder: Path, controller: str, flock: str = 'strombom', noise: float = 0.0) -> Path:
    """Record one episode with seed 9; return the bag."""
    config = EnvConfig(world=world(flock), noise_std=noise, lidar=LIDAR)
    record_episodes(config, make_controller(controller, world(flock)), range(9, 10), folder)
    return episode_folder(folder, 9)


def whole(bag: Path) -> RecordedEpisode:
    """Return the only episode of a bag."""
    (episode,) = iter_episodes(open_bag(bag))
    return episode


@pytest.mark.parametrize('at', [0, 1, 13, STEPS])
@pytest.mark.parametrize(
    ('controller', 'flock', 'noise'),
    [
        ('pierson', 'strombom', 0.0),
        ('pierson', 'reynolds', 0.5),
        ('strombom', 'strombom', 0.5),
        ('random', 'reynolds', 0.0),
    ],
)
def test_the_same_controller_makes_the_recorded_future(
    at: int, controller: str, flock: str, noise: float, tmp_path: Path
) -> None:
    bag = recorded(tmp_path, controller, flock, noise)
    law = make_controller(controller, world(flock))
    same = record_future(whole(bag), at, law, noise, tmp_path / 'again')
    assert same == (at > 0)
    result = diff_bags(open_bag(bag), open_bag(tmp_path / 'again'), times=True)
    assert result.equal, result.text()


def test_another_controller_shares_the_past_and_makes_another_future(tmp_path: Path) -> None:
    bag, at = recorded(tmp_path, 'pierson'), 8
    law = make_controller('strombom', world())
    assert not record_future(whole(bag), at, law, 0.0, tmp_path / 'other')
    was, would_be = whole(bag), whole(tmp_path / 'other')
    for before, after in zip(was.frames, would_be.frames, strict=True):
        same = np.array_equal(before.shepherds, after.shepherds)
        assert same == (before.step <= at)
    assert check_bag(open_bag(tmp_path / 'other'), ('scans', 'commands')).ok


def test_the_other_future_is_that_of_the_environment_told_to_do_the_same(tmp_path: Path) -> None:
    bag, at = recorded(tmp_path, 'strombom'), 5
    law = make_controller('pierson', world())
    record_future(whole(bag), at, law, 0.0, tmp_path / 'other')
    frames = whole(tmp_path / 'other').frames
    env = ShepherdEnv(EnvConfig(world=world()), 1, lidar=False)
    env.reset(9)
    first, second = make_controller('strombom', world()), law
    memory = first.begin(env.perceived)
    for t in range(STEPS):
        if t == at:
            memory = second.begin(env.perceived)
        assert np.array_equal(frames[t].sheep, env.state.sheep[0].numpy()), t
        command, memory = (first if t < at else second).act(env.perceived, memory)
        env.step(command)


def test_a_goal_that_was_moved_moves_again(tmp_path: Path) -> None:
    bag = recorded(tmp_path, 'pierson')
    sent = open_bag(bag).messages()
    rows = [Sent(m.topic, m.type, m.data, m.log_ns, m.publish_ns) for m in sent]
    ns = 6_000_000_000
    goal = Sent('/goal', 'geometry_msgs/msg/PoseStamped', encode_goal(ns, 'map', 3, 4), ns, ns)
    moved = write(tmp_path / 'moved', [*rows, goal])
    law = make_controller('idle', world())
    record_future(whole(moved), 4, law, 0.0, tmp_path / 'other')
    goals = [frame.goal.tolist() for frame in whole(tmp_path / 'other').frames]
    assert goals == [[0.0, 0.0]] * 11 + [[3.0, 4.0]] * 10


def test_metrics_are_compared_after_the_last_common_step(tmp_path: Path) -> None:
    episode = whole(recorded(tmp_path, 'pierson'))
    short = replace(episode, frames=episode.frames[:11])
    lines = metrics_table(short, episode, 'a name').splitlines()
    assert lines[0] == '| after 10 steps | recorded | a name | unit |'
    for line in lines[2:]:
        _, name, left, right, _, _ = line.split('|')
        assert left == right, name


# ---- the verb ----


@pytest.fixture
def counterfactual(capsys: pytest.CaptureFixture[str]) -> Callable[..., Said]:
    """Return what runs the verb: exit code, stdout and stderr."""

    def run(*words: object) -> Said:
        code = main(['counterfactual', *map(str, words)])
        output = capsys.readouterr()
        return code, output.out, output.err

    return run


@pytest.mark.system
def test_the_verb_writes_a_bag_a_table_and_pictures_of_both_futures(
    tmp_path: Path, counterfactual: Callable[..., Said]
) -> None:
    bag, out = recorded(tmp_path, 'pierson'), tmp_path / 'out'
    code, output, _ = counterfactual(bag, '--at', 4.2, '--controller', 'strombom', '--out', out)
    assert code == 0
    assert 'strombom from 4 s on, from there, without any memory' in output
    table = (out / 'metrics.md').read_text()
    assert table in output
    assert table.startswith('| after 20 steps | recorded | strombom from 4 s on | unit |')
    assert check_bag(open_bag(out / 'bag'), ('scans', 'commands')).ok
    picture, film = Image.open(out / 'futures.png'), Image.open(out / 'futures.gif')
    assert film.n_frames == STEPS + 1
    for image, scale in ((picture, 2), (film, 1)):
        pixels = np.asarray(image.convert('RGB')).astype(int)
        assert pixels.shape[1] > 1.4 * pixels.shape[0]
        left, right = np.split(pixels, 2, axis=1)
        axes = slice(70 * scale, -100 * scale)
        same = (left[axes] == right[axes]).all()
        assert same == (image is film)  # the film begins in the common past
    film.seek(STEPS)
    left, right = np.split(np.asarray(film.convert('RGB')).astype(int), 2, axis=1)
    assert (left[70:-100] != right[70:-100]).any()


def test_the_verb_tells_that_the_recorded_controller_goes_on(
    tmp_path: Path, counterfactual: Callable[..., Said]
) -> None:
    bag, out = recorded(tmp_path, 'pierson', noise=0.5), tmp_path / 'out'
    words = ['--at', 4, '--controller', 'pierson', '-p', 'noise_std:=0.5', '-o', out]
    code, output, _ = counterfactual(bag, *words)
    assert code == 0
    assert 'with its memory of the past' in output
    assert diff_bags(open_bag(bag), open_bag(out / 'bag'), times=True).equal


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['--at', '0.4'], '--at is 0.4: expected a stamp of the episode, 0.5 to 10.5 s'),
        (['--at', '11'], '--at is 11.0: expected a stamp of the episode'),
        (['--at', 'nan'], '--at is nan: expected a stamp of the episode'),
        (['--at', '1', '--controller', 'dog'], "controller is 'dog': expected one of"),
        (['--at', '1', '-p', 'lead:=1.0'], "parameter of strombom is 'lead'"),
        (['--at', '1', '--episode', '2'], '--episode is 2: expected an episode with states'),
        (['--at', '1', '-o', '{file}/x'], '--out is {file}/x: expected a folder'),
        (
            ['--at', '1', '-o', '{there}'],
            '{there}, which holds something else, such as bag: expected a new folder',
        ),
    ],
)
def test_a_mistake_is_named(
    words: list[str], message: str, tmp_path: Path, counterfactual: Callable[..., Said]
) -> None:
    places = {'file': str(tmp_path / 'file'), 'there': str(tmp_path / 'there')}
    Path(places['file']).touch()
    (tmp_path / 'there' / 'bag').mkdir(parents=True)
    words = ['-o', str(tmp_path / 'new'), *(word.format(**places) for word in words)]
    code, out, err = counterfactual(recorded(tmp_path, 'strombom'), *words)
    assert (code, out.strip()) == (2, '')
    assert message.format(**places) in err
    assert err.count('\n') == 1
