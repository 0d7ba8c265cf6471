"""Command-line arguments made from a configuration: same names, defaults, texts and choices."""

from __future__ import annotations

from dataclasses import field, fields, make_dataclass
from functools import reduce
import operator
from typing import Annotated, Any, Literal, TypeVar

from shepherd_ros.config import choices_of, Config
import tyro

_C = TypeVar('_C', bound=Config)


def arguments_of(
    default: Config, hidden: tuple[str, ...] = (), several: bool = False
) -> type[Any]:
    """
    Return a dataclass of arguments with the values of a configuration as defaults.

    A tuple is an argument that may come again. several: each takes any number of values, none at
    first.
    """
    rows: list[Any] = []
    for f in fields(default):
        value = getattr(default, f.name)
        if f.name in hidden:
            continue
        if isinstance(value, Config):
            nested = arguments_of(value)
            rows.append((f.name, nested, field(default_factory=nested)))
            continue
        kind: Any = type(value)
        if choices := choices_of(f.metadata):
            kind = Literal[choices]
        if isinstance(value, tuple):
            kind = tyro.conf.UseAppendAction[tuple[str, ...]]
        elif several:
            kind, value = tuple[kind, ...], ()
        if 'doc' in f.metadata:
            rows.append((f.name, Annotated[kind, tyro.conf.arg(help=f.metadata['doc'])], value))
    for name, (value, metadata) in default.added().items():
        rows.append((name, Annotated[type(value), tyro.conf.arg(help=metadata['doc'])], value))
    return make_dataclass(type(default).__name__, rows, namespace={'__doc__': default.__doc__})


def plain(arguments: Any) -> dict[str, Any]:
    """Return arguments as nested plain data, ready for Config.from_dict()."""
    return {
        f.name: plain(value) if hasattr(value, '__dataclass_fields__') else value
        for f in fields(arguments)
        for value in [getattr(arguments, f.name)]
    }


def configured(kind: type[_C], arguments: Any) -> _C:
    """Return the configuration that arguments ask for, or raise ConfigError."""
    return kind.from_dict(plain(arguments))


def verb_group(doc: str, **verbs: type[Any]) -> type[Any]:
    """Return a verb that runs the one of its own verbs that is named."""
    choices: list[Any] = [
        Annotated[verb, tyro.conf.subcommand(name)] for name, verb in verbs.items()
    ]
    rows = [('verb', Annotated[reduce(operator.or_, choices), tyro.conf.arg(name='')])]
    run = {'__doc__': doc, 'run': lambda group: group.verb.run()}
    return make_dataclass('Verbs', rows, namespace=run)
