"""The page of commands, read from the help that users see."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from functools import partial
import io
import os
import re
from typing import Any

from shepherd_ros.cli import main
from shepherd_ros.cli.train_help import BAGS, option_groups, policy_groups, usage
from shepherd_ros.cli.train_verbs import DEFAULT_RECIPES, TRAININGS
from shepherd_ros.nodes.herd_node import HerdOptions
from shepherd_ros.nodes.player_node import PlayerOptions
from shepherd_ros.nodes.recorder_options import RecorderOptions
from shepherd_ros.ros.runtime import parse_options

from manual.tables import code, escaped, page, table

WIDTH = '110'  # one column of panels
COMMON = ('positional arguments', 'options')
NODES: dict[str, Any] = {
    'recorder': RecorderOptions, 'player': PlayerOptions, 'herd': HerdOptions
}  # fmt: skip


@dataclass
class Help:
    """The help of a command: usage, what it does, options by group, subcommands."""

    usage: str
    about: str
    groups: dict[str, list[list[str]]] = field(default_factory=dict)
    subcommands: list[str] = field(default_factory=list)

    @property
    def options(self) -> set[str]:
        """Return the options, such as --out and -o."""
        return {
            word.strip().split(' ')[0]
            for rows in self.groups.values()
            for row in rows
            for word in row[0].strip('`').split(',')
        }


def help_text(call: Callable[[list[str]], Any], words: list[str]) -> str:
    """Return what a command prints with --help."""
    before = os.environ.get('COLUMNS')
    out = io.TextIOWrapper(io.BytesIO(), encoding='utf-8')  # with an encoding, as a terminal has
    os.environ['COLUMNS'] = WIDTH
    try:
        with redirect_stdout(out), redirect_stderr(out):
            call([*words, '--help'])
    except SystemExit:
        pass
    finally:
        os.environ.pop('COLUMNS')
        if before is not None:
            os.environ['COLUMNS'] = before
    out.seek(0)
    return re.sub(r'\x1b\[[0-9;]*m', '', out.read())


def _row(lines: list[str]) -> list[str]:
    """Return option, default and meaning from the lines of one option."""
    first, *rest = lines
    name, _, meaning = first.partition('  ')
    text = ' '.join([meaning, *rest])
    text = ' '.join(text.split())
    match = re.search(r' ?\((?:default: ?([^()]*(?:\([^()]*\))?[^()]*)|(required))\)$', text)
    default = '' if match is None else (match[2] or match[1])
    shown = default if default == 'required' else code(default.replace("''", ''))
    return [code(name), shown, escaped(text[: match.start()] if match else text)]


def parsed(text: str) -> Help:
    """Return a help text in parts."""
    head, *panels = re.split(r'^╭─ (.*?) ─*╮$', text, flags=re.MULTILINE)
    usage, _, about = head.strip().partition('\n\n')
    result = Help(usage.removeprefix('usage: '), ' '.join(about.split('\n\n')[0].split()))
    more = re.search(r'\{([\w,-]+)\}', usage)
    if more and 'subcommands' in panels:
        result.subcommands = more[1].split(',')
    for title, body in zip(panels[::2], panels[1::2], strict=True):
        if title == 'subcommands':
            continue
        lines = [line[2:-1].rstrip() for line in body.splitlines() if line.startswith('│')]
        blocks: list[list[str]] = []
        started = not any(set(line.strip()) == {'─'} for line in lines)
        for line in lines:
            if set(line.strip()) == {'─'}:
                started = True
            elif started and line[:1].strip():
                blocks.append([line])
            elif started and blocks:
                blocks[-1].append(line)
        rows = [_row(block) for block in blocks if not block[0].startswith('-h,')]
        if rows:
            result.groups[title] = rows
    return result


def training(name: str) -> Help:
    """Return the help of a training, with the options of its policy."""
    recipe = DEFAULT_RECIPES[name]
    page_help = Help(usage(name), TRAININGS[name])
    if name == 'bc':
        page_help.groups['Arguments'] = [[code('BAG'), code('required'), escaped(BAGS)]]
    for title, rows in (*option_groups(recipe.run), *policy_groups(recipe.policy)):
        page_help.groups[title] = [[code(r.name), code(r.default), escaped(r.text)] for r in rows]
    return page_help


def verbs(words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Help]]:
    """Yield every verb of shepherd with its help, those with subcommands before them."""
    if words[:1] == ('train',) and len(words) == 2:
        yield words, training(words[1])
        return
    verb_help = parsed(help_text(main, list(words)))
    if words == ('train',) and not verb_help.subcommands:
        raise ValueError('shepherd train --help names no subcommands')
    yield words, verb_help
    for name in verb_help.subcommands:
        yield from verbs((*words, name))


def _section(name: str, command_help: Help, level: int) -> str:
    """Return the section of a command."""
    parts = [f'{"#" * level} {name}', command_help.about, f'```text\n{command_help.usage}\n```']
    rows = [row for title in COMMON for row in command_help.groups.get(title, [])]
    groups = {title: more for title, more in command_help.groups.items() if title not in COMMON}
    for title, more in {'': rows, **groups}.items():
        parts.append(f'**{title.removesuffix(" options")}**' if title else '')
        parts.append(table(('argument', 'default', 'meaning'), more) if more else '')
    return '\n\n'.join(part for part in parts if part)


def commands() -> str:
    """Return the page of all commands."""
    parts = []
    for words, found in verbs():
        if words:
            parts.append(_section(' '.join(('shepherd', *words)), found, 1 + len(words)))
    for name, options in NODES.items():
        found = parsed(help_text(partial(parse_options, options, name), []))
        parts.append(_section(name, found, 2))
    intro = (
        'Every verb of `shepherd`, then the nodes that have command-line options. '
        '`shepherd VERB --help` prints the same. Exit codes: 0 success, 1 the answer is no '
        '(a check failed), 2 a mistake in what was given, 130 Ctrl-C.'
    )
    return page('Commands', intro, *parts)
