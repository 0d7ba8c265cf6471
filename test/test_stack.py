"""The stack that demo and launch file start, and the files beside the nodes."""

import ast
from pathlib import Path

import pytest
from shepherd_ros.cli import main
from shepherd_ros.config import ConfigError
from shepherd_ros.nodes.defaults import parameter_file, WITH_FILE
from shepherd_ros.share import share_file
from shepherd_ros.stack import herding_stack, LAUNCH_ARGUMENTS, launch_values
from shepherd_ros.topics import renamed_topics
import yaml

ROOT = Path(__file__).resolve().parents[1]
DEFAULTS = {name: default for name, (default, _) in LAUNCH_ARGUMENTS.items()}


@pytest.mark.parametrize('name', WITH_FILE)
def test_a_parameter_file_is_the_defaults_of_its_node(name: str) -> None:
    text = share_file('config', f'{name}.yaml').read_text(encoding='utf-8')
    assert text == parameter_file(name)
    assert yaml.safe_load(text)[f'/**/{name}']['ros__parameters']


def test_the_stack_has_a_lidar_for_each_shepherd_and_distinct_names() -> None:
    stack = herding_stack('pierson', 5, n_sheep=7, wait_for_scans=True)
    assert [p.executable for p in stack].count('lidar') == 5
    assert len({p.name for p in stack}) == len(stack) == 8
    assert stack[0].arguments() == [
        '--ros-args', '-r', '__node:=flock_sim', '-p', 'n_shepherds:=5', '-p', 'n_sheep:=7',
        '-p', 'wait_for_scans:=true',
    ]  # fmt: skip


def test_every_parameter_that_the_launch_file_sets_is_one_of_flock_sim() -> None:
    known = yaml.safe_load(share_file('config', 'flock_sim.yaml').read_text())
    values = launch_values(DEFAULTS)
    assert set(values.flock_sim) <= set(known['/**/flock_sim']['ros__parameters'])
    assert values.flock_sim.items() <= known['/**/flock_sim']['ros__parameters'].items()


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
    ],
)
def test_a_bad_launch_argument_is_named(given: dict[str, str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        launch_values(DEFAULTS | given)


def test_the_launch_file_declares_the_arguments_and_reads_them_from_the_stack() -> None:
    source = (ROOT / 'launch' / 'simulate.launch.py').read_text(encoding='utf-8')
    names = {node.id for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Name)}
    assert {'LAUNCH_ARGUMENTS', 'launch_values', 'herding_stack'} <= names
    functions = [n.name for n in ast.parse(source).body if isinstance(n, ast.FunctionDef)]
    assert 'generate_launch_description' in functions


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['demo', '--controller', 'piersen'], "did you mean 'pierson'"),
        (['demo', '--flock', 'boids'], "flock is 'boids': expected one of reynolds, strombom"),
        (['demo', '--sheep', '0'], '--sheep is 0: expected at least 1'),
        (['demo', '--animation', 'avi'], "--animation is 'avi': expected gif, mp4 or none"),
        (['evaluate', '--controllers', 'dog'], "controller is 'dog': expected one of"),
        (['evaluate', '--episodes', '0'], '--episodes is 0: expected at least 1'),
        (['evaluate', '--shepherds', '0'], 'n_shepherds is 0: expected a value in'),
        (['evaluate', '--preset', 'papr'], "preset is 'papr'"),
    ],
)
def test_a_bad_word_after_shepherd_is_named(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    assert message in capsys.readouterr().err
