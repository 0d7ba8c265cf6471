"""Frozen, checked and documented configuration: the base that every dataclass here shares."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
import difflib
import math
from typing import Any, TypeVar

C = TypeVar('C', bound='Config')


class ConfigError(ValueError):
    """An invalid value of the user: the message names value, expectation and fix."""


def option(
    default: Any,
    doc: str,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: Iterable[str] | Callable[[], Iterable[str]] = (),
    sparse: bool = False,
) -> Any:
    """
    Return a dataclass field with a default, a sentence and the closed range it may lie in.

    choices are called when they are needed if they can be: the names of a registry are not known
    while modules are imported. A sparse option is in to_dict() only where it is not the default.
    """
    metadata = {'doc': doc, 'low': low, 'high': high, 'choices': choices, 'sparse': sparse}
    return field(default=default, metadata=metadata)


def choices_of(metadata: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the values that an option may have, none if it may have any."""
    choices = metadata.get('choices', ())
    return tuple(choices() if callable(choices) else choices)


def unknown_name(kind: str, name: object, known: list[str] | tuple[str, ...]) -> ConfigError:
    """Return the error for a name that is none of those known, with the nearest one if any."""
    near = difflib.get_close_matches(str(name)[:100], known, n=1)  # a name may be of any length
    hint = f'; did you mean {near[0]!r}?' if near else ''
    return ConfigError(f'{kind} is {name!r}: expected one of {", ".join(known)}{hint}')


def checked(name: str, value: Any, default: Any, metadata: Mapping[str, Any]) -> Any:
    """
    Return the value in the type of its default, or raise ConfigError.

    An int is taken where a float is expected; NaN and infinity are refused everywhere.
    """
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        try:
            value = float(value)
        except OverflowError:
            value = math.inf
    if type(value) is not type(default):
        raise ConfigError(
            f'{name} is {value!r} ({type(value).__name__}): expected {type(default).__name__}, '
            f'such as {default!r}'
        )
    low, high = metadata.get('low'), metadata.get('high')
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f'{name} is {value}: expected a finite number, such as {default}')
    if (low is not None and value < low) or (high is not None and value > high):
        interval = f'[{"-inf" if low is None else low}, {"inf" if high is None else high}]'
        raise ConfigError(f'{name} is {value}: expected a value in {interval}, such as {default}')
    choices = choices_of(metadata)
    if choices and value not in choices:
        raise unknown_name(name, value, choices)
    return value


def read(name: str, text: str, example: Any) -> Any:
    """Return text as a value of the type of an example, or raise ConfigError."""
    if isinstance(example, bool):
        if text not in ('true', 'false'):
            raise ConfigError(f'{name} is {text!r}: expected true or false')
        return text == 'true'
    try:
        return type(example)(text)
    except ValueError:
        raise ConfigError(
            f'{name} is {text!r}: expected {type(example).__name__}, such as {example}'
        ) from None


def part(kind: type[Config], default: type[Config] | None = None) -> Any:
    """Return a dataclass field that holds a configuration of a kind, its default one at first."""
    return field(default_factory=default or kind, metadata={'part': kind})


def mapping(name: str, value: Any) -> Mapping[str, Any]:
    """Return a value that has to be a mapping of names to values, or raise ConfigError."""
    if not isinstance(value, Mapping):
        raise ConfigError(f'{name} is {value!r}: expected a mapping of names to values')
    return value


@dataclass(frozen=True)
class Config:
    """A frozen dataclass whose fields are made with option() and checked on creation."""

    def __post_init__(self) -> None:
        """Check every field against its default's type, its range and its choices."""
        for f in fields(self):
            kind = f.metadata.get('part')
            if kind is not None and not isinstance(getattr(self, f.name), kind):
                raise ConfigError(
                    f'{f.name} is {getattr(self, f.name)!r}: expected a {kind.__name__}'
                )
            if 'doc' in f.metadata:
                value = checked(f.name, getattr(self, f.name), f.default, f.metadata)
                object.__setattr__(self, f.name, value)

    def added(self) -> dict[str, tuple[Any, Mapping[str, Any]]]:
        """Return value and metadata, as option() gives it, of the options that plug-ins add."""
        return {}

    def to_dict(self) -> dict[str, Any]:
        """Return plain nested data, ready for JSON."""
        return {
            f.name: value.to_dict() if isinstance(value, Config) else value
            for f in fields(self)
            for value in [getattr(self, f.name)]
            if not (f.metadata.get('sparse') and value == f.default)
        }

    def changes(self) -> dict[str, Any]:
        """Return nested data of the values that differ from the defaults, for from_dict()."""
        changed: dict[str, Any] = {}
        for f in fields(self):
            value, default = getattr(self, f.name), f.default
            if isinstance(value, Config):
                value, default = value.changes(), {}
            if value != default:
                changed[f.name] = value
        return changed

    def values(self) -> dict[str, Any]:
        """Return every value by its path, such as `flock.noise` of a world."""
        by_path: dict[str, Any] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, Config):
                by_path |= {f'{f.name}.{path}': inner for path, inner in value.values().items()}
            elif 'doc' in f.metadata:
                by_path[f.name] = value
        return by_path | {name: value for name, (value, _) in self.added().items()}

    def with_values(self: C, changes: Mapping[str, Any]) -> C:
        """Return the configuration with other values by path, or raise; text is read()."""
        known = self.values()
        inner: dict[str, dict[str, Any]] = {}
        own: dict[str, Any] = {}
        for path, value in changes.items():
            if path not in known:
                raise _unknown_path(path, list(known))
            if isinstance(value, str):
                value = read(path, value, known[path])
            name, _, rest = path.partition('.')
            if rest:
                inner.setdefault(name, {})[rest] = value
            else:
                own[name] = value
        parts = {name: getattr(self, name).with_values(more) for name, more in inner.items()}
        return replace(type(self).from_dict(self.to_dict() | own), **parts)

    def equals(self, stored: Any) -> bool:
        """Return whether data of to_dict() equals this; missing values have their defaults."""
        try:
            return type(self).from_dict(mapping(type(self).__name__, stored)) == self
        except ConfigError:
            return False

    @classmethod
    def from_dict(cls: type[C], data: Mapping[str, Any]) -> C:
        """Return the configuration that to_dict() gave; absent is default, unknown an error."""
        known = {f.name: f for f in fields(cls)}
        values: dict[str, Any] = {}
        for name, value in data.items():
            if name not in known:
                raise unknown_name(f'{cls.__name__} field', name, list(known))
            kind = known[name].metadata.get('part')
            if kind is not None:
                value = kind.from_dict(mapping(name, value))
            values[name] = value
        return cls(**values)


def _unknown_path(path: str, known: list[str]) -> ConfigError:
    """Return the error for a path that is none of those known, with the nearest one if any."""
    near = [name for name in known if name.endswith(f'.{path}')]
    near += difflib.get_close_matches(path, known, n=1)
    hint = f'did you mean {near[0]!r}?' if near else f'expected a path such as {known[0]!r}'
    return ConfigError(f'there is no option {path!r}; {hint}')
