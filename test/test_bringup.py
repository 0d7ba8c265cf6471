"""The stack that demo and launch file start, and the files beside the nodes."""

import ast
from dataclasses import replace
from pathlib import Path
import xml.etree.ElementTree as ET

import pytest
import rclpy
from rclpy.context import Context
from shepherd_ros.bringup import controller_process, herding_stack, stack_in, with_console
from shepherd_ros.cli import main
from shepherd_ros.config import ConfigError
from shepherd_ros.experiments.methods import make_method
from shepherd_ros.experiments.setting import canonical_setting, Setting
from shepherd_ros.launch_arguments import (
    LAUNCH_ARGUMENTS,
    launch_values,
    REPLAY_ARGUMENTS,
    replay_values,
    ReplayValues,
    require_success,
)
from shepherd_ros.nodes.compose import NODES
from shepherd_ros.nodes.herd_node import HerdOptions
from shepherd_ros.policy.checkpoint import load_policy, save_policy, shipped_checkpoints
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.resources import quick_profile, share_file
from shepherd_ros.ros.runtime import parse_options
from shepherd_ros.sim.flocking import FLOCK_MODELS
from shepherd_ros.sim.flocking.flock_model import FlockConfig
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.presets import PRESETS
from shepherd_ros.wire.topics import renamed_topics
import yaml

ROOT = Path(__file__).resolve().parents[1]
DEFAULTS = {name: default for name, (default, _) in LAUNCH_ARGUMENTS.items()}


@pytest.mark.parametrize('name', sorted(NODES.keys() - {'controller'}))
def test_a_parameter_file_is_of_its_node(name: str) -> None:
    text = share_file('config', f'{name}.yaml').read_text(encoding='utf-8')
    assert yaml.safe_load(text)[f'/**/{name}']['ros__parameters']


@pytest.mark.parametrize('controller', sorted(PRESETS['paper'].controllers))
def test_heuristics_of_a_stack_have_the_options_of_its_preset(controller: str) -> None:
    wanted = make_method(controller, Setting(preset='paper')).config
    assert wanted != make_method(controller, Setting()).config
    context = Context()
    rclpy.init(args=[], context=context)
    more = {} if controller == 'pierson' else {'arc_margin': 7.0}  # what is given wins
    stack = herding_stack(controller, preset='paper')
    process = replace(stack[-1], parameters=stack[-1].parameters | more)
    node = NODES[controller](
        context=context, cli_args=process.arguments(), use_global_arguments=False
    )
    assert node.options == replace(wanted, **more)
    node.destroy_node()
    context.try_shutdown()


def test_a_composite_of_a_stack_has_its_parts_as_parameters() -> None:
    stack = stack_in(Setting(preset='paper'), 'composite:policy:strombom,drover,0.5,1')
    process = stack[-1]
    assert (process.executable, process.name) == ('composite', 'composite')
    assert process.parameters == {
        'drive': 'policy:strombom', 'hold': 'drover', 'home_within': 0.5, 'away_beyond': 1.0,
        'preset': 'paper',
    }  # fmt: skip
    plain = controller_process('composite', {})
    assert plain.parameters == {}


def test_the_stack_has_a_lidar_for_each_shepherd_and_distinct_names() -> None:
    (learned,) = [p for p in herding_stack('policy', 2) if p.name == 'policy']
    assert learned.parameters == {'checkpoint': 'general'}  # its default is all shepherds
    of_reynolds = controller_process('policy', {'flock': 'reynolds'})
    assert of_reynolds.parameters['checkpoint'] == 'reynolds'
    assert controller_process('policy:general', {}).parameters['checkpoint'] == 'general'
    assert FlockConfig.checkpoint == 'general'  # of a new model
    assert {m.config.checkpoint for m in FLOCK_MODELS.values()} <= set(shipped_checkpoints())
    stack = herding_stack('pierson', 5, n_sheep=7, wait_for_scans=True)
    assert [p.executable for p in stack].count('lidar') == 5
    assert len({p.name for p in stack}) == len(stack) == 8
    assert stack[0].arguments() == [
        '--ros-args', '-r', '__node:=flock_sim', '-p', 'n_shepherds:=5', '-p', 'n_sheep:=7',
        '-p', 'wait_for_scans:=true',
    ]  # fmt: skip


def test_mux_stands_between_its_controllers_and_the_world() -> None:
    setting = Setting(shepherds=2, set=('noise_std=0.1',))
    plain = stack_in(setting, 'strombom', seed=3)
    stack = stack_in(setting, 'strombom', mux=True, standby=('policy:general', 'pierson'), seed=3)
    assert [p.name for p in stack[-4:]] == ['mux', 'policy', 'pierson', 'strombom']
    mux, learned, pierson, own = stack[-4:]
    assert mux.parameters == {
        'default': 'strombom',
        'topics.policy.priority': 9, 'topics.policy.answers': True,
        'topics.pierson.priority': 8, 'topics.pierson.answers': True,
    }  # fmt: skip
    assert own.parameters == plain[-1].parameters | {'source': 'strombom'}
    assert learned.parameters == {'checkpoint': 'general', 'source': 'policy'}
    assert pierson.parameters['noise_std'] == own.parameters['noise_std'] == 0.1
    assert stack[0].parameters == plain[0].parameters | {'wait_for_scans': True}
    assert stack[1:-4] == plain[1:-1]


@pytest.mark.parametrize(
    ('standby', 'mux', 'message'),
    [
        (('pierson',), False, "standby is 'pierson': expected none without mux"),
        (('strombom',), True, "standby has 'strombom': expected each controller once"),
        (('policy', 'policy:general'), True, "standby has 'policy': expected each controller"),
        (('persson',), True, 'did you mean .pierson'),
        (('idle',) * 10, True, 'standby has 10: expected at most 9'),
    ],
)
def test_controllers_that_cannot_stand_by_are_named(
    standby: tuple[str, ...], mux: bool, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        stack_in(Setting(), 'strombom', mux=mux, standby=standby)


def test_a_console_comes_with_mux_and_one_lidar_for_all() -> None:
    values = launch_values(DEFAULTS | {'console': 'true'})
    assert values.console
    assert values.mux
    stack = stack_in(Setting(shepherds=3, set=('lidar.range_noise=0.1',)), 'strombom', mux=True)
    watched = with_console(stack, port=0)
    assert [p.name for p in watched] == [
        'flock_sim', 'lidar', 'console', 'metrics', 'mux', 'strombom',
    ]  # fmt: skip
    assert watched[1].parameters == {'shepherd_ids': [-1], 'range_noise': 0.1}
    assert watched[2].parameters == {'port': 0}


def test_launch_file_and_herd_take_mux_in_with_one_argument() -> None:
    values = launch_values(DEFAULTS | {'mux': 'true', 'standby': 'pierson drover'})
    assert (values.mux, values.standby) == (True, ['pierson', 'drover'])
    herd = parse_options(HerdOptions, 'herd', ['--mux', '--standby', 'pierson', 'drover'])
    assert (herd.mux, herd.standby) == (True, ('pierson', 'drover'))
    assert not launch_values(DEFAULTS).mux


def test_every_parameter_that_the_launch_file_sets_is_one_of_flock_sim() -> None:
    known = yaml.safe_load(share_file('config', 'flock_sim.yaml').read_text())
    values = launch_values(DEFAULTS)
    assert set(values.flock_sim) <= set(known['/**/flock_sim']['ros__parameters'])
    assert values.flock_sim.items() <= known['/**/flock_sim']['ros__parameters'].items()
    assert values.setting == canonical_setting(Setting())
    stack = stack_in(values.setting, values.controller, **values.flock_sim)
    assert stack[0].parameters.items() <= known['/**/flock_sim']['ros__parameters'].items()


def test_what_a_setting_changes_reaches_the_nodes_that_have_it() -> None:
    given = {'n_sheep': '7', 'repulsion': '1.5', 'start': 'scattered', 'noise_std': '0.5'}
    words = 'world.shepherd_speed=2 world.flock.noise=0.1 lidar.range_noise=0.2'
    values = launch_values(DEFAULTS | given | {'set': words})
    stack = {p.executable: p for p in stack_in(values.setting, 'pierson', seed=3)}
    changed = {
        'flock_sim': {
            'n_sheep': 7, 'shepherd_speed': 2.0, 'strombom.noise': 0.1, 'seed': 3,
            'strombom.sheep_repulsion': 1.5, 'spawn.position_std': 5.0,
        },
        'lidar': {'noise_std': 0.5, 'range_noise': 0.2},
        'pierson': {'noise_std': 0.5},
    }  # fmt: skip
    for name, parameters in changed.items():
        text = share_file('config', f'{name}.yaml').read_text(encoding='utf-8')
        known = yaml.safe_load(text)[f'/**/{name}']['ros__parameters']
        differ = {k: v for k, v in stack[name].parameters.items() if known[k] != v}
        differ.pop('shepherd_ids', None)
        assert differ == parameters
    options = ['--sheep', '7', '--repulsion', '1.5', '--start', 'scattered', '--noise', '0.5']
    for word in words.split():
        options += ['--set', word]
    herd = parse_options(HerdOptions, 'herd', options)
    assert stack_in(herd.setting, 'pierson', seed=3) == stack_in(values.setting, 'pierson', seed=3)


def test_lidars_of_a_stack_touch_bodies_as_the_policy_knows_it(tmp_path: Path) -> None:
    path = tmp_path / 'facing.safetensors'
    network = NetworkConfig(filters_1=2, filters_2=2, hidden=2)
    save_policy(
        path, Policy(PolicyConfig(lidar=LidarConfig(contact='facing'), network=network)), {}
    )
    lidars = [p for p in stack_in(Setting(), f'policy:{path}') if p.executable == 'lidar']
    assert [p.parameters['contact'] for p in lidars] == ['facing'] * 3
    lidars = [p for p in stack_in(Setting(), 'policy:imitation') if p.executable == 'lidar']
    assert not any('contact' in p.parameters for p in lidars)


@pytest.mark.parametrize('name', shipped_checkpoints())
def test_lidars_of_a_stack_are_those_that_a_shipped_policy_knows(name: str) -> None:
    config = load_policy(name).config
    stack = stack_in(Setting(task=config.task), f'policy:{name}')
    for lidar in (p for p in stack if p.executable == 'lidar'):
        options = {k: v for k, v in lidar.parameters.items() if k != 'shepherd_ids'}
        assert LidarConfig(**options) == config.lidar


def test_a_viewer_of_a_stack_in_a_namespace_gets_its_topics() -> None:
    renames = dict(renamed_topics('/farm', 2))
    assert renames['/markers'] == '/farm/markers'
    assert renames['/shepherd_1/scan/goal'] == '/farm/shepherd_1/scan/goal'
    assert '/shepherd_2/scan/goal' not in renames
    assert '/clock' not in renames
    assert renamed_topics('', 2) == []


@pytest.mark.parametrize(
    ('given', 'message'),
    [
        ({'n_sheep': 'many'}, "n_sheep is 'many': expected int, such as 100"),
        ({'rate': 'fast'}, "rate is 'fast': expected float"),
        ({'rviz': 'yes'}, "rviz is 'yes': expected true or false"),
        ({'rviz': 'true'}, 'expected false, as rviz2 is not installed'),
        ({'mux': 'yes'}, "mux is 'yes': expected true or false"),
        ({'mode': 'fast'}, "mode is 'fast': expected one of lockstep, realtime"),
        ({'seed': str(2**70)}, 'seed is 1180591620717411303424: expected a value in'),
        ({'preset': 'papr'}, "did you mean 'paper'"),
        ({'params_file': '/nowhere.yaml'}, 'params_file is /nowhere.yaml: expected a YAML file'),
        ({'params_file': str(ROOT / 'LICENSE')}, 'expected a'),
        ({'record': str(ROOT)}, 'expected a folder that is not there yet'),
        ({'namespace': '1farm'}, "namespace is '1farm': expected letters"),
        ({'checkpoint': 'general'}, "checkpoint is 'general': expected none with controller"),
    ],
)
def test_a_bad_launch_argument_is_named(given: dict[str, str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        launch_values(DEFAULTS | given)


@pytest.mark.parametrize(
    ('given', 'message'),
    [
        ({'controller': 'nonsense'}, "controller is 'nonsense': expected one of"),
        (
            {'controller': 'pierson:general'},
            'expected pierson alone; a colon follows only c',
        ),
        ({'controller': 'policy', 'checkpoint': 'nowhere'}, "checkpoint is 'nowhere': expected a"),
    ],
)
def test_a_controller_that_cannot_herd_there_is_named_before_any_process_starts(
    given: dict[str, str], message: str
) -> None:
    values = launch_values(DEFAULTS | given)
    with pytest.raises(ConfigError, match=message):
        stack_in(values.setting, values.controller, **values.flock_sim)


def test_a_launch_ends_with_the_failure_of_a_node() -> None:
    require_success('lidar-3', 0)
    require_success('lidar-3', -9)  # ended by somebody
    with pytest.raises(ConfigError, match='lidar-3 ended with exit code 2'):
        require_success('lidar-3', 2)


@pytest.mark.parametrize(
    ('file', 'used'),
    [
        ('simulate', {'LAUNCH_ARGUMENTS', 'launch_values', 'stack_in', 'require_success'}),
        ('replay', {'REPLAY_ARGUMENTS', 'replay_values', 'require_success'}),
    ],
)
def test_the_launch_file_declares_the_arguments_and_reads_them_from_the_stack(
    file: str, used: set[str]
) -> None:
    source = (ROOT / 'launch' / f'{file}.launch.py').read_text(encoding='utf-8')
    names = {node.id for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Name)}
    assert used <= names
    functions = [n.name for n in ast.parse(source).body if isinstance(n, ast.FunctionDef)]
    assert 'generate_launch_description' in functions


RECORDED = ['/clock', '/episode', '/flock/poses', '/shepherd_0/cmd_vel', '/shepherd_0/scan/goal']


def replayed(topics: list[str] = RECORDED, **given: str) -> ReplayValues:
    """Return what the launch file makes of its arguments."""
    return replay_values(
        {name: default for name, (default, _) in REPLAY_ARGUMENTS.items()} | {'bag': 'b'} | given,
        topics,
    )


def test_a_bag_is_played_as_a_whole_unless_a_controller_answers() -> None:
    assert replayed().player == ['b', '--rate', '1.0']
    assert replayed(rate='2', loop='true').player == ['b', '--rate', '2.0', '--loop']
    words = replayed(controller='pierson').player
    played = words[words.index('--topics') + 1 :]
    assert played == [name for name in RECORDED if name != '/shepherd_0/cmd_vel']
    assert (replayed().delay, replayed(controller='pierson', delay='3').delay) == (0.0, 3.0)


def test_the_player_takes_the_words_of_the_launch_file() -> None:
    tyro = pytest.importorskip('tyro')
    options = pytest.importorskip('shepherd_ros.nodes.player_options').PlayerOptions
    words = replayed(controller='pierson', rate='2', loop='true').player
    parsed = tyro.cli(options, args=words)
    assert (parsed.bag, parsed.rate, parsed.loop) == (Path('b'), 2.0, True)
    assert parsed.topics == ('/clock', '/episode', '/flock/poses', '/shepherd_0/scan/goal')


def test_a_namespace_takes_the_place_of_the_recorded_one() -> None:
    assert (replayed().remaps, replayed().namespace) == ([], '')
    values = replayed(namespace='/farm/')
    assert (values.namespace, values.n_shepherds) == ('farm', 1)
    assert dict(values.remaps) == {name: f'/farm{name}' for name in RECORDED if name != '/clock'}
    topics = [name if name == '/clock' else f'/field{name}' for name in RECORDED]
    assert (replayed(topics).remaps, replayed(topics).namespace) == ([], 'field')
    moved = dict(replayed(topics, namespace='farm').remaps)
    assert moved['/field/flock/poses'] == '/farm/flock/poses'
    assert '/clock' not in moved


def test_the_quick_profiles_of_both_fast_dds_say_the_same() -> None:
    def settings(name: str) -> list[tuple[str, str]]:
        nodes = ET.parse(ROOT / 'config' / name).getroot().iter()
        names = ((node.tag.rpartition('}')[2], (node.text or '').strip()) for node in nodes)
        return [(name.replace('_p', 'P'), text) for name, text in names]

    assert settings('fastdds_quick.xml') == settings('fastdds3_quick.xml')
    variable, profile = quick_profile()
    assert ('FASTDDS' in variable) == (profile.name == 'fastdds3_quick.xml')


@pytest.mark.parametrize(
    ('given', 'message'),
    [
        ({'rate': 'fast'}, "rate is 'fast': expected float, such as 1.0"),
        ({'delay': ''}, "delay is '': expected float, such as 5.0"),
        ({'loop': 'yes'}, "loop is 'yes': expected true or false"),
        ({'rviz': '1'}, "rviz is '1': expected true or false"),
    ],
)
def test_a_bad_argument_of_the_replay_is_named(given: dict[str, str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        replayed(**given)


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['demo', '--controller', 'piersen'], "did you mean 'pierson'"),
        (['demo', '--flock', 'boids'], "flock is 'boids': expected one of"),
        (['demo', '--sheep', '0'], 'n_sheep is 0: expected a value in'),
        (['demo', '--set', 'reward.shaping=1'], 'reward.shaping is 1.0: expected its default'),
        (['demo', '--rays', '64'], 'rays is 64: expected 512, as in training'),
        (['demo', '--animation', 'avi'], "--animation is 'avi': expected gif, mp4 or none"),
        (['evaluate', '9'], "experiment is '9': expected one of"),
    ],
)
def test_a_bad_word_after_shepherd_is_named(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    assert message in capsys.readouterr().err
