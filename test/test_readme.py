"""What README.md says is so."""

import ast
from pathlib import Path
import re
import shlex

import pytest
from shepherd_ros.controllers import CONTROLLERS
from shepherd_ros.wire.topics import contract

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / 'README.md').read_text(encoding='utf-8')
BLOCKS = re.findall(r'```(\w+)\n(.*?)```', README, re.DOTALL)
COMMANDS = [
    line for kind, block in BLOCKS if kind == 'bash' for line in block.splitlines() if line
]


def test_every_path_named_exists() -> None:
    named = re.findall(r'`([a-z_]+/[\w./<>{}]*)`|\]\(([\w/.]+)\)', README)
    paths = {a or b for a, b in named} - {'src/'} - set(contract()[0])
    paths = {p for p in paths if '<' not in p and not p.startswith('out/')}  # out/ is made
    places = (ROOT, ROOT / 'shepherd_ros')
    missing = [p for p in paths if not any((place / p).exists() for place in places)]
    assert not missing
    assert len(paths) > 5


@pytest.mark.parametrize('line', [line for line in COMMANDS if line.startswith('make')])
def test_make_knows_the_targets(line: str) -> None:
    target = line.split()[1]
    assert re.search(rf'^{target}:', (ROOT / 'Makefile').read_text(), re.MULTILINE)


@pytest.mark.parametrize('line', [line for line in COMMANDS if line.startswith('ros2 run')])
def test_every_executable_is_installed_and_every_parameter_known(line: str) -> None:
    words = shlex.split(line, comments=True)
    assert words[2] == 'shepherd_ros'
    setup = (ROOT / 'setup.py').read_text()
    assert words[3] in CONTROLLERS or f"'{words[3]}': " in setup
    config = ROOT / 'config' / f'{words[3]}.yaml'
    for word in words:
        if ':=' in word and not word.startswith('__') and words[words.index(word) - 1] == '-p':
            assert f'    {word.split(":=")[0]}: ' in config.read_text()


@pytest.mark.parametrize('code', [block for kind, block in BLOCKS if kind == 'python'])
def test_the_python_example_runs(code: str, capsys: pytest.CaptureFixture[str]) -> None:
    ast.parse(code)
    exec(compile(code, 'README.md', 'exec'), {})
    share = float(re.findall(r'[\d.]+', capsys.readouterr().out)[0])
    assert 0.0 < share <= 1.0
