"""Markdown of generated pages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields
from typing import Any

from shepherd_ros.config import choices_of, Config

NOTE = '<!-- Made by `make generate`: edit the code, not this page. -->\n\n'


def page(title: str, *parts: str) -> str:
    """Return a page of Markdown with a title."""
    return NOTE + '\n\n'.join([f'# {title}', *(part.strip() for part in parts)]) + '\n'


def escaped(text: Any) -> str:
    """Return a text that may stand in a cell."""
    return ' '.join(str(text).split()).replace('|', r'\|').replace('<', '&lt;')


def code(text: Any) -> str:
    """Return a text as code in a cell, nothing if it is empty."""
    shown = ' '.join(str(text).split()).replace('|', r'\|')
    return f'`{shown}`' if shown else ''


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of cells that are Markdown already."""
    lines = [head, ['---'] * len(head), *rows]
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines)


def bounds(low: Any, high: Any, choices: Any = None) -> str:
    """Return a range or choices as text, empty if all values are allowed."""
    if choices:
        return ', '.join(code(choice) for choice in choices)
    if low is None or high is None:
        return (
            f'at least {low:.12g}' if low is not None else f'at most {high:.12g}' if high else ''
        )
    return f'{low:.12g} to {high:.12g}'


def fields_of(config: Config, prefix: str = '') -> list[list[str]]:
    """Return a row for each option of a configuration, nested ones by their path."""
    rows = []
    for f in fields(config):
        value, about = getattr(config, f.name), f.metadata
        if isinstance(value, Config):
            rows += fields_of(value, f'{prefix}{f.name}.')
            continue
        allowed = bounds(about.get('low'), about.get('high'), choices_of(about))
        shown = f'{value:.6g}' if isinstance(value, float) else value
        rows.append([code(prefix + f.name), code(shown), allowed, escaped(about.get('doc', ''))])
    return rows


FIELDS = ('field', 'default', 'allowed', 'meaning')
