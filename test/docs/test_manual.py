"""README and manual: limits, links, numbers, and the words of commands."""

import ast
import csv
from itertools import pairwise
from pathlib import Path
import re
import shlex
import xml.etree.ElementTree as ET

from manual_blocks import blocks, DOCS, README, ROOT, WRITTEN
import pytest
from shepherd_ros.controllers import CONTROLLERS
from shepherd_ros.nodes.executables import FILES
from shepherd_ros.wire.contract import known
import yaml

PAGES = [path for path in WRITTEN if path != ROOT / 'CONTRIBUTING.md']
OF_OTHERS = ('joy', 'teleop_twist_joy', 'teleop_twist_keyboard')  # packages of ROS 2
SETUP = (ROOT / 'setup.py').read_text(encoding='utf-8')
LINES = sorted(
    {(path.name, line) for path in WRITTEN for b in blocks(path) if b.kind == 'bash'
     for line in b.lines}
)  # fmt: skip
# of another host, whose page would call it; `make docs` looks at the pages as they are built
CALLED = re.compile(r'!\[[^]]*\]\(http|<(?:img|script|link)[^>]*="(?:http|//)')
METRICS = {
    'time': 'completion_time',
    'path': 'shepherd_path_length',
    'in goal at the end': 'fraction_in_goal',
    'completion time': 'completion_time',
    'fraction reached': 'fraction_reached',
    'fraction in goal': 'fraction_in_goal',
    'shepherd path': 'shepherd_path_length',
    'path to completion': 'shepherd_path_to_completion',
}


def section(page: str, title: str) -> str:
    """Return the text below a heading of a page of the reference."""
    text = (DOCS / 'reference' / page).read_text(encoding='utf-8')
    found = re.search(rf'^#+ {re.escape(title)}$(.*?)(?=^#+ |\Z)', text, re.M | re.S)
    assert found, f'{title} is not in {page}'
    return found[1]


def starting(word: str) -> list[tuple[str, str]]:
    """Return the commands that start with a word."""
    return [(name, line) for name, line in LINES if f'{line} '.startswith(f'{word} ')]


# ---- README ----


def test_readme_fits_one_page() -> None:
    text = README.read_text(encoding='utf-8')
    assert len(text.splitlines()) <= 150
    assert max(len(line) for line in text.splitlines()) <= 90
    assert len(text.split()) < 1200


def test_badges_are_true() -> None:
    text = README.read_text(encoding='utf-8')
    ci = yaml.safe_load((ROOT / '.github/workflows/ci.yml').read_text(encoding='utf-8'))
    versions = ci['jobs']['test']['strategy']['matrix']['python']
    assert f'Python-{"_%7C_".join(versions)}-blue' in text
    assert "license='Apache-2.0'" in SETUP and 'licence-Apache--2.0-blue' in text
    assert "'jazzy': [" in SETUP and 'ROS_2-Jazzy-blue' in text


def test_the_citation_names_this_version_and_its_maintainers() -> None:
    cited = yaml.safe_load((ROOT / 'CITATION.cff').read_text(encoding='utf-8'))
    manifest = ET.parse(ROOT / 'package.xml').getroot()
    assert str(cited['version']) == manifest.findtext('version')
    assert cited['license'] == manifest.findtext('license')
    assert [author['name'] for author in cited['authors']] == [
        maintainer.text for maintainer in manifest.iter('maintainer')
    ]


# ---- words of commands ----


@pytest.mark.parametrize('name, line', starting('shepherd') + starting('torchrun'))
def test_shepherd_knows_verb_and_options(name: str, line: str) -> None:
    words = shlex.split(line, comments=True)
    words = words[words.index('shepherd') + 1 :]
    if words[0] == '--tyro-write-completion':  # of tyro; a shell runs it in test_command_line
        assert words[1] in ('bash', 'zsh', 'tcsh')
        return
    verb = [word for word in words[:2] if re.fullmatch('[a-z]+', word)]
    if verb[0] not in ('bag', 'train', 'dataset', 'checkpoint'):
        verb = verb[:1]
    about = section('commands.md', f'shepherd {" ".join(verb)}')
    known = set(re.findall(r'(?<![\w-])(--?[\w.-]+)', about))
    for word in words[len(verb) :]:
        if re.match('--?[a-z]', word):
            assert word in known, f'{word} is no option of shepherd {" ".join(verb)}'


@pytest.mark.parametrize('name, line', starting('ros2 run'))
def test_every_executable_and_parameter_exists(name: str, line: str) -> None:
    words = shlex.split(line, comments=True)
    if words[2] in OF_OTHERS:
        remapped = {word.partition(':=')[2] for word in words if ':=' in word}
        assert all(known(f'/{topic}') for topic in remapped)
        return
    assert words[2] == 'shepherd_ros'
    node = words[3]
    assert node in CONTROLLERS or node in FILES
    if node in ('recorder', 'player', 'herd'):
        listed = section('commands.md', node)
        assert all(w in listed for w in words[4:] if w.startswith('-'))
        return
    listed = section('parameters.md', node)
    for before, word in pairwise(words):
        parameter = word.partition(':=')[0]
        own = parameter.startswith('shy.') or node == 'controller'  # of the tutorials
        example = re.sub(r'^topics\.\w+', 'topics.keys', parameter)  # of any source of mux
        own |= bool(re.fullmatch(r'locks\.\w+\.(topic|priority|timeout)', parameter))
        assert before != '-p' or own or f'`{example}`' in listed


@pytest.mark.parametrize('name, line', starting('ros2 launch'))
def test_every_launch_file_and_argument_exists(name: str, line: str) -> None:
    from shepherd_ros.launch_arguments import LAUNCH_ARGUMENTS, REPLAY_ARGUMENTS

    words = shlex.split(line, comments=True)
    assert (ROOT / 'launch' / words[3]).is_file()
    known = REPLAY_ARGUMENTS if 'replay' in words[3] else LAUNCH_ARGUMENTS
    assert {word.partition(':=')[0] for word in words[4:] if ':=' in word} <= set(known)


@pytest.mark.parametrize('name, line', starting('ros2 service call'))
def test_every_service_exists(name: str, line: str) -> None:
    words = shlex.split(line)
    text = (DOCS / 'reference/services.md').read_text()
    rows = re.findall(r'^\| `(.*?)` \| `(.*?)` \|', text, re.MULTILINE)
    patterns = {
        re.sub(r'\\{\w+\\}', r'\\w+', re.escape(name)): kind for name, kind in rows
    }  # {source} and {h} stand for words
    assert words[4] in [k for pattern, k in patterns.items() if re.fullmatch(pattern, words[3])]


@pytest.mark.parametrize('name, line', starting('make'))
def test_make_knows_the_targets_and_names(name: str, line: str) -> None:
    makefile = (ROOT / 'Makefile').read_text()
    target, *names = line.split('#')[0].split()[1:]
    assert re.search(rf'^{target}:', makefile, re.MULTILINE)
    for word in names:
        assert re.search(rf'\b{word.partition("=")[0]}\b', makefile)


@pytest.mark.parametrize('name, line', [(n, x) for n, x in LINES if "'.[" in x])
def test_pip_knows_the_extras(name: str, line: str) -> None:
    for extra in re.findall(r'\[([\w,]+)\]', line)[0].split(','):
        assert f"'{extra}': [" in SETUP


# ---- links and paths ----


def slug(heading: str) -> str:
    """Return the anchor of a heading, as GitHub and MyST make it."""
    return re.sub(r'[^\w\- ]', '', heading.strip().lower()).replace(' ', '-')


@pytest.mark.parametrize('page', WRITTEN, ids=lambda path: path.name)
def test_links_inside_resolve(page: Path) -> None:
    text = re.sub(r'```.*?```', '', page.read_text(encoding='utf-8'), flags=re.S)
    for target in re.findall(r'\]\(([^)\s]+)\)', text):
        if target.startswith(('http', '#')):
            continue
        name, _, anchor = target.partition('#')
        path = page.parent / name
        assert path.exists(), f'{target} of {page.name}'
        if anchor:
            headings = re.findall(r'^#+ (.*)$', path.read_text(encoding='utf-8'), re.M)
            assert anchor in {slug(heading) for heading in headings}, f'{target} of {page.name}'


def test_pages_call_no_other_host() -> None:
    for page in WRITTEN:
        if page.is_relative_to(DOCS):
            assert not CALLED.findall(page.read_text(encoding='utf-8')), page


@pytest.mark.parametrize('page', PAGES, ids=lambda path: path.name)
def test_every_path_named_exists(page: Path) -> None:
    made = [
        'out',
        'runs',
        'bags',
        'src',
        'meta',
        'metrics',
        'mux',
        'teacher',
        'markers',
        'flock',
        'std_msgs',
    ]
    named = re.findall(r'`([a-z_]+/[\w./]*)`', page.read_text(encoding='utf-8'))
    for path in named:
        folder = path.split('/')[0]
        assert folder in made or folder.startswith('shepherd') or (ROOT / path).exists(), path


# ---- numbers ----


@pytest.mark.parametrize('page', PAGES, ids=lambda path: path.name)
def test_a_line_of_prose_has_two_numbers_at_most(page: Path) -> None:
    text = page.read_text(encoding='utf-8')
    text = re.sub(r'```.*?```|`[^`]*`|\]\([^)]*\)|<!--.*?-->|\$\$.*?\$\$', '', text, flags=re.S)
    for line in text.splitlines():
        if not line.startswith(('|', '#', '!', ':')):
            line = re.sub(r'(Python|torch|numba|ROS|version|REP|Access|T-RO) [\d.:()]+', '', line)
            line = re.sub(r'\b(19|20)\d\d\b', '', line)
            found = re.findall(r'(?<![\w.])\d[\d.,]*', line)
            assert len(found) <= 2, line


def tables() -> list[tuple[str, dict[str, str], list[list[str]]]]:
    """Return page, filter and rows of each table that says which results it shows."""
    found = []
    for page in WRITTEN:
        text = page.read_text(encoding='utf-8')
        for about, body in re.findall(r'<!-- rows: (.*?) -->\n((?:\|.*\n)+)', text):
            rows = [[c.strip() for c in line.strip('|').split('|')] for line in body.splitlines()]
            found.append((page.name, dict(w.split('=') for w in about.split()), rows))
    return found


@pytest.mark.parametrize('name, about, rows', tables())
def test_tables_show_the_results(name: str, about: dict[str, str], rows: list[list[str]]) -> None:
    with (DOCS / 'results/summary.csv').open(encoding='utf-8') as file:
        results = [r for r in csv.DictReader(file) if about.items() <= r.items()]
    head, _, *body = rows
    for row in body:
        controller = re.findall('`(.*?)`', row[0])[0]
        for title, shown in zip(head[1:], row[1:], strict=True):
            metric = METRICS[title.split(' [')[0]]
            (mean,) = [
                float(r['mean'])
                for r in results
                if r['controller'] == controller and r['metric'] == metric
            ]
            digits = len(shown.partition('.')[2])
            assert abs(float(shown) - mean) <= 0.5001 * 10**-digits, f'{controller} {metric}'


# ---- errors ----


def test_messages_of_the_troubleshooting_page_are_in_the_code() -> None:
    texts = [
        ''.join(
            part.value if isinstance(part, ast.Constant) else '\0'
            for part in (node.values if isinstance(node, ast.JoinedStr) else [node])
            if not isinstance(part, ast.Constant) or isinstance(part.value, str)
        )
        for path in (ROOT / 'shepherd_ros').rglob('*.py')
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8')))
        if isinstance(node, ast.JoinedStr)
        or (isinstance(node, ast.Constant) and isinstance(node.value, str))
    ]
    page = (DOCS / 'troubleshooting.md').read_text(encoding='utf-8')
    quoted = [' '.join(q.split()) for q in re.findall(r'^> (.*(?:\n> .*)*)', page, re.M)]
    assert len(quoted) > 5
    for quote in quoted:
        parts = [part.strip() for part in re.split(r'\.\.\.|\{\w+\}', quote)]
        parts = [part for part in parts if len(part) > 3]
        assert any(all(part in text for part in parts) for text in texts), quote
