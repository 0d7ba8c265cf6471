"""A controller that is shown the past says again what it said; another one does not."""

from collections.abc import Callable
from dataclasses import replace
import os
from pathlib import Path
import re
import sys

import numpy as np
import pytest
from rosbag2.tiny import Sent, without, write
from shepherd_ros.cli import main
from shepherd_ros.controllers import make_controller
from shepherd_ros.recordings.episodes import iter_episodes, RecordedEpisode
from shepherd_ros.recordings.record import episode_folder, record_episodes
from shepherd_ros.recordings.replay import exact_heading, states_of
from shepherd_ros.recordings.replay_check import Comparison, frames_to_check
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.presets import world_preset
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.vectors import unit
from shepherd_ros.wire.decode import decode_poses
from shepherd_ros.wire.encode import encode_poses
import torch

STEPS, NOISE = 12, 0.5
WORLD = replace(world_preset('default'), n_sheep=8, n_shepherds=2, episode_steps=STEPS)
EVERY = f'{2 * (STEPS + 1)} commands of 1 episodes compared: {2 * (STEPS + 1)} equal, 0 differ'
Said = tuple[int, str, str]


def recorded(folder: Path, controller: str, noise_std: float = NOISE, **options: float) -> Path:
    """Record one episode of a controller; return the bag."""
    config = EnvConfig(world=WORLD, noise_std=noise_std)
    law = make_controller(controller, WORLD, **options)
    record_episodes(config, law, range(5, 6), folder)
    return episode_folder(folder, 5)


@pytest.fixture
def replay(capsys: pytest.CaptureFixture[str]) -> Callable[..., Said]:
    """Return what asks the law: exit code, stdout and stderr."""

    def run(*words: object) -> Said:
        code = main(['replay', *map(str, words), '--without-ros'])
        output = capsys.readouterr()
        return code, output.out, output.err

    return run


@pytest.mark.parametrize('controller', ['strombom', 'pierson', 'idle', 'random'])
def test_the_same_law_says_the_same(
    controller: str,
    tmp_path: Path,
    replay: Callable[..., Said],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bag = recorded(tmp_path, controller)
    monkeypatch.setattr('shepherd_ros.cli.progress.LINE_PERIOD', 0.0)
    code, out, err = replay(bag, '--controller', controller, '-p', f'noise_std:={NOISE}')
    commands = [int(line.split()[1]) for line in err.splitlines()]  # comparing: N commands
    assert commands and commands == sorted(commands)
    assert f'{commands[-1]} commands of 1 episodes compared' in out
    assert code == 0
    assert EVERY in out
    assert 'difference: 0 m/s at most, 0 m/s on average' in out
    assert out.endswith('\nequal\n')


@pytest.mark.parametrize(
    'words',
    [
        ['--controller', 'strombom', '-p', 'noise_std:=0.5'],
        ['--controller', 'pierson'],  # without the noise
        ['--controller', 'pierson', '-p', 'noise_std:=0.5', 'lead:=3.0'],
    ],
)
def test_another_law_or_other_parameters_say_something_else(
    words: list[str], tmp_path: Path, replay: Callable[..., Said]
) -> None:
    code, out, _ = replay(recorded(tmp_path, 'pierson'), *words)
    assert code == 1
    assert re.search(
        r'first difference: episode 0, step \d+, stamp [\d.]+ s, shepherd_\d: \(', out
    )
    assert out.endswith('\ndifferent\n')


def test_parameters_come_from_a_file_of_ros_and_words_win(
    tmp_path: Path, replay: Callable[..., Said]
) -> None:
    bag = recorded(tmp_path, 'pierson', lead=3.0)
    file = tmp_path / 'params.yaml'
    file.write_text(
        '/**/strombom: {ros__parameters: {noise: 0.1}}\n'
        '/**/pierson: {ros__parameters: {lead: 4.0, noise_std: 0.5, executor: events}}\n'
    )
    words = [bag, '--controller', 'pierson', '--params-file', file]
    assert replay(*words)[0] == 1
    assert replay(*words, '-p', 'lead:=3.0')[0] == 0


def test_a_tolerance_lets_small_differences_pass(
    tmp_path: Path, replay: Callable[..., Said]
) -> None:
    bag = recorded(tmp_path, 'pierson', spread_factor=3.00001)
    words = [bag, '--controller', 'pierson', '-p', 'noise_std:=0.5']
    assert replay(*words)[0] == 1
    code, out, _ = replay(*words, '--tolerance', '0.001')
    assert code == 0
    assert ' 0 equal, ' not in out
    assert 'differ by more than 0.001 m/s' in out


def messages(bag: Path) -> list[Sent]:
    """Return what is in a bag, to be written into another one."""
    return [
        Sent(m.topic, m.type, m.data, m.log_ns, m.publish_ns) for m in open_bag(bag).messages()
    ]


def test_what_is_missing_in_the_recording_is_named_and_no_success(
    tmp_path: Path, replay: Callable[..., Said]
) -> None:
    bag = recorded(tmp_path, 'pierson')
    words = ['--controller', 'pierson', '-p', 'noise_std:=0.5']
    holed = write(tmp_path / 'a', without(messages(bag), '/shepherd_1/cmd_vel', 3))
    code, out, _ = replay(holed, *words)
    assert code == 1
    where = 'episode 0, step 3, stamp 2.000000000 s, shepherd_1: no command in the recording'
    assert f'missing: 1 commands; {where}\n' in out
    assert replay(holed, *words, '--shepherds', 0)[0] == 0
    holed = write(tmp_path / 'b', without(messages(bag), '/flock/poses', 3))
    code, out, _ = replay(holed, *words)
    assert code == 1
    assert 'not asked: 1 states' in out
    last = write(tmp_path / 'c', without(messages(bag), '/shepherd_1/cmd_vel', -1))
    assert replay(last, *words)[0] == 0  # a recording may end before the last answer
    rows = [m for m in messages(bag) if 'cmd_vel' not in m.topic]
    code, out, _ = replay(write(tmp_path / 'd', rows), *words)
    assert code == 1
    assert 'missing: 24 commands' in out


def whole(bag: Path) -> RecordedEpisode:
    """Return the only episode of a bag."""
    (episode,) = iter_episodes(open_bag(bag))
    return episode


def test_differences_by_hand(tmp_path: Path) -> None:
    episode = whole(recorded(tmp_path, 'idle'))
    result = Comparison(tolerance=1.0)
    nothing = np.zeros(2)
    for t, frame in enumerate(episode.frames[:4]):
        second = [nothing, np.array([0.3, 0.4]), np.array([3.0, 4.0]), np.full(2, np.nan)][t]
        result.add(episode, frame, {0: nothing, 1: second})
    assert (result.compared, result.equal, result.n_beyond, result.missing) == (8, 5, 2, 0)
    assert (result.max_difference, result.sum_of_differences) == (np.inf, np.inf)
    assert result.first.endswith('step 2, stamp 1.500000000 s, shepherd_1: (0, 0), now (3, 4) m/s')
    result = Comparison(tolerance=1.0)
    result.add(episode, episode.frames[0], {0: np.array([0.6, 0.8]), 1: nothing})
    assert (result.ok, result.equal, result.max_difference, result.sum_of_differences) == (
        True,
        1,
        1.0,
        1.0,
    )
    result.add(episode, episode.frames[1], {0: nothing})
    assert (result.ok, result.missing) == (False, 1)
    assert result.first_missing.endswith('shepherd_1: no command from the controller')


def test_in_real_time_only_states_that_were_answered_are_asked_about(tmp_path: Path) -> None:
    episode = whole(recorded(tmp_path, 'pierson'))
    frames = [replace(f, commands=[None, None]) if f.step % 3 else f for f in episode.frames]
    late = replace(episode, frames=frames, mode='realtime')
    assert [frame.step for frame in frames_to_check(late)] == [0, 3, 6, 9, 12]
    assert frames_to_check(replace(late, mode=episode.mode)) == frames


@pytest.mark.parametrize('flock', ['strombom', 'reynolds'])
def test_a_bag_has_the_states_of_the_environment_to_the_last_bit(
    flock: str, tmp_path: Path
) -> None:
    world = replace(world_preset('default', flock), n_sheep=50, episode_steps=40)
    controller = make_controller('pierson', world)
    record_episodes(EnvConfig(world=world), controller, range(1), tmp_path)
    states = states_of(whole(episode_folder(tmp_path, 0)))
    env = ShepherdEnv(EnvConfig(world=world), 1, lidar=False)
    env.reset(0)
    memory = controller.begin(env.perceived)
    for t in range(40):
        for name in ('seed', 'step', 'sheep', 'heading', 'shepherds', 'goal', 'goal_radius'):
            reference = getattr(env.state, name)[0]
            assert torch.equal(getattr(states, name)[t], reference), f'{name} at {t}'
        command, memory = controller.act(env.perceived, memory)
        env.step(command)


def test_headings_come_back_from_their_directions() -> None:
    generator = torch.Generator().manual_seed(0)
    random = torch.randn(100_000, 2, generator=generator)
    special = torch.tensor([[1.0, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, 1], [1, -1]])
    heading = unit(torch.cat([special, random])).numpy()
    read = decode_poses(encode_poses(0, 'map', np.zeros_like(heading), heading)).heading
    assert np.array_equal(exact_heading(read), heading)
    rounded = (read.astype(np.float32) != heading).any(axis=1)
    assert rounded.mean() > 0.1  # which is why it takes more than rounding


def test_without_ros_installed_the_other_way_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(os, 'environ', dict(os.environ))
    monkeypatch.setitem(sys.modules, 'shepherd_ros.nodes.controller_probe', None)
    assert main(['replay', str(recorded(tmp_path, 'idle')), '--controller', 'idle']) == 2
    assert 'install ROS 2, or use --without-ros' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['--controller', 'piersen'], "controller is 'piersen': expected one of"),
        (['-p', 'lead:=3'], "parameter of strombom is 'lead': expected one of"),
        (['-p', 'noise'], "--params has 'noise': expected name:=value"),
        (['-p', 'noise:=[1'], "--params has 'noise:=[1': expected name:=value"),
        (['-p', 'noise:=many'], "noise is 'many' (str): expected float"),
        (['-p', 'stamped:=false'], 'expected commands with the stamp of their state'),
        (['--params-file', 'none.yaml'], '--params-file is none.yaml: expected a YAML file'),
        (['--tolerance', '-1'], '--tolerance is -1.0: expected 0 or more'),
        (['--episode', '1'], '--episode is 1: expected 0 to 0, as `shepherd bag info'),
        (['--shepherds', '2'], '--shepherds has [2]: expected 0 to 1'),
        (['--namespace', '/farm'], "namespace is '/farm'; expected one of ['']"),
    ],
)
def test_a_mistake_is_named(
    words: list[str], message: str, tmp_path: Path, replay: Callable[..., Said]
) -> None:
    code, out, err = replay(recorded(tmp_path, 'strombom'), *words)
    assert (code, out) == (2, '')
    assert message in err
    assert err.count('\n') == 1
