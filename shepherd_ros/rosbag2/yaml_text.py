"""
Plain data as YAML: written as yaml-cpp does it for rosbag2, read with suspicion.

yaml.dump cannot write it word for word: entries of lists are not indented, texts that need quotes
get single ones, and nothing is null instead of ~.
"""

from __future__ import annotations

import json
from pathlib import Path
import re
from typing import Any

from shepherd_ros.rosbag2.errors import BagError
import yaml

LARGEST = 16 << 20  # [bytes] of metadata that are worth reading
LONGEST_KEY = 1024  # characters of a key that needs no question mark
DEEPEST = 30  # levels of nested lists and maps; rosbag2 has 8
_LOADER = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
_PLAIN = re.compile(r'[A-Za-z/][A-Za-z0-9_/.]*')
_WORDS_OF_YAML = {'y', 'n', 'yes', 'no', 'on', 'off', 'true', 'false', 'null'}
_EXOTIC = re.compile('[^ -~]')


def dump_yaml(data: Any) -> str:
    """Return maps, lists, texts, whole numbers, bools and None as YAML, in the order given."""
    return _value(data, '').lstrip() + '\n'


def _value(data: Any, indent: str) -> str:
    """Return what stands behind a colon or a dash: a scalar, or lines that begin with indent."""
    if isinstance(data, dict) and data:
        inner = indent + '  '
        rows = (f'{_key(key, indent)}:{_value(value, inner)}' for key, value in data.items())
    elif isinstance(data, list) and data:
        # the first line of an entry stands behind its dash
        rows = (f'- {_value(value, indent + "  ").lstrip()}' for value in data)
    else:
        return f' {_scalar(data)}'
    return ''.join(f'\n{indent}{row}' for row in rows)


def _key(key: str, indent: str) -> str:
    text = _scalar(key)
    return text if len(text) < LONGEST_KEY else f'? {text}\n{indent}'


def _scalar(value: Any) -> str:
    if isinstance(value, str):
        if _PLAIN.fullmatch(value) and value.lower() not in _WORDS_OF_YAML:
            return value
        # what JSON quotes, YAML understands, but for characters that it does not print
        return _EXOTIC.sub(_escape, json.dumps(value, ensure_ascii=False))
    return '~' if value is None else json.dumps(value)


def _escape(match: re.Match[str]) -> str:
    code = ord(match[0])
    return f'\\u{code:04x}' if code < 0x10000 else f'\\U{code:08x}'


def load_yaml(text: str, path: Path) -> Any:
    """Return the plain data of a YAML text of a file; raises BagError."""
    try:
        if len(text) > LARGEST:
            raise ValueError(f'{len(text)} characters: expected at most {LARGEST}')
        _check_nesting(text)
        return yaml.load(text, Loader=_LOADER)
    except (yaml.YAMLError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise BagError(path, f'its metadata is no YAML ({line_of(error)})') from error


def _check_nesting(text: str) -> None:
    """Refuse what would make the loader run out of stack or of memory; raises ValueError."""
    depth = 0
    for event in yaml.parse(text, Loader=_LOADER):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > DEEPEST or isinstance(event, yaml.AliasEvent):
            raise ValueError(f'an alias, or more than {DEEPEST} levels')


def line_of(error: Exception) -> str:
    """Return what an error says, in one line of at most 120 characters."""
    return ' '.join(str(error).split())[:120] or type(error).__name__
