"""
Registries: the entries of one kind by name, those of plug-ins among them.

A plug-in is a module that adds entries when it is imported. Installed packages name theirs by the
entry point group `shepherd_ros.plugins`; the environment variable SHEPHERD_ROS_PLUGINS names
others, by import path or as Python files, with commas between them. They are imported when a
registry is first asked, in every process alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from importlib import import_module
from importlib.metadata import entry_points
import importlib.util
import os
from pathlib import Path
import sys
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from shepherd_ros.config import C, checked, Config, ConfigError, unknown_name

PLUGIN_GROUP = 'shepherd_ros.plugins'
PLUGIN_VARIABLE = 'SHEPHERD_ROS_PLUGINS'
_loaded: set[str] = set()


class Named(Protocol):
    """Whatever has a name."""

    @property
    def name(self) -> str:
        """Return the name by which the entry is found."""
        ...


E = TypeVar('E', bound=Named)


class UnknownEntryError(ConfigError, KeyError):
    """A name that a registry does not have."""

    __str__ = Exception.__str__  # that of KeyError has quotes


class Registry(Mapping[str, E], Generic[E]):
    """
    Entries by name, in the order in which they were added.

    Looking up a name that is not there raises ConfigError, which lists those that are. Code that
    runs while modules are imported must not look anything up: plug-ins may need those modules.
    """

    def __init__(self, kind: str) -> None:
        """Begin without entries; kind names them in errors, such as 'flock'."""
        self.kind = kind
        self._entries: dict[str, E] = {}

    def add(self, entry: E) -> E:
        """Add an entry and return it; ConfigError if another has its name."""
        if self._entries.setdefault(entry.name, entry) is not entry:
            raise ConfigError(
                f'{self.kind} {entry.name!r} is there already: expected another name'
            )
        return entry

    def remove(self, name: str) -> None:
        """Remove an entry that was added."""
        del self._entries[name]

    def __getitem__(self, name: str) -> E:
        """Return the entry of a name, or raise ConfigError."""
        load_plugins()
        if name not in self._entries:
            raise UnknownEntryError(unknown_name(self.kind, name, sorted(self._entries)))
        return self._entries[name]

    def __contains__(self, name: object) -> bool:
        """Return whether an entry has that name."""
        load_plugins()
        return name in self._entries

    def __iter__(self) -> Iterator[str]:
        """Yield the names."""
        load_plugins()
        return iter(list(self._entries))

    def loaded(self) -> Mapping[str, E]:
        """Return all entries as they are now, for loops where look-ups would take long."""
        load_plugins()
        return self._entries

    def __len__(self) -> int:
        """Return the number of entries."""
        load_plugins()
        return len(self._entries)


@dataclass(frozen=True)
class Extended(Config):
    """
    A configuration with the options that entries of a registry add, by their names.

    An entry has name, default, meaning, low and high. Plain data has only values that differ from
    their defaults.
    """

    registry: ClassVar[Mapping[str, Any]]
    others: tuple[tuple[str, Any], ...] = field(default=(), kw_only=True)  # those that differ

    def __post_init__(self) -> None:
        """Check every option."""
        super().__post_init__()
        others = []
        for name, value in sorted(self.others):
            known = self.registry.keys() - self._own()
            if name not in known:
                names = [*self._own(), *sorted(known)]
                raise unknown_name(f'{type(self).__name__} field', name, names)
            entry = self.registry[name]
            value = checked(name, value, entry.default, _limits(entry))
            others += [(name, value)] if value != entry.default else []
        object.__setattr__(self, 'others', tuple(others))

    @classmethod
    def _own(cls) -> list[str]:
        """Return the names of fields."""
        return [f.name for f in fields(cls) if f.metadata]

    def added(self) -> dict[str, tuple[Any, Mapping[str, Any]]]:
        """Return value and metadata of the options that plug-ins add."""
        values, own = dict(self.others), self._own()
        return {
            name: (values.get(name, entry.default), _limits(entry))
            for name, entry in self.registry.items()
            if name not in own
        }

    def to_dict(self) -> dict[str, Any]:
        """Return plain nested data."""
        data = super().to_dict()
        return data | dict(data.pop('others'))

    def changes(self) -> dict[str, Any]:
        """Return plain nested data of the values that differ from the defaults."""
        changes = super().changes()
        return changes | dict(changes.pop('others', ()))

    @classmethod
    def from_dict(cls: type[C], data: Mapping[str, Any]) -> C:
        """Return the configuration that to_dict() gave, or raise ConfigError."""
        own = [f.name for f in fields(cls) if f.metadata]
        known = super().from_dict({name: data[name] for name in data if name in own})
        others = tuple((name, value) for name, value in data.items() if name not in own)
        return replace(known, **{'others': others}) if others else known


def _limits(entry: Any) -> Mapping[str, Any]:
    """Return the metadata of an option that an entry adds."""
    return {'doc': entry.meaning, 'low': entry.low, 'high': entry.high}


def load_plugins() -> None:
    """Import the plug-ins that are not imported yet, or raise ConfigError."""
    installed = [] if PLUGIN_GROUP in _loaded else entry_points(group=PLUGIN_GROUP)
    _loaded.add(PLUGIN_GROUP)
    for point in installed:
        _import(point.value, f'entry point {point.name!r} of group {PLUGIN_GROUP}')
    for name in _named_plugins():
        _import(name, PLUGIN_VARIABLE)


def plugin_names() -> list[str]:
    """Return the modules and files of plug-ins that are installed or named."""
    return [*(point.value for point in entry_points(group=PLUGIN_GROUP)), *_named_plugins()]


def _named_plugins() -> list[str]:
    """Return the modules and files that the environment names."""
    names = os.environ.get(PLUGIN_VARIABLE, '').split(',')
    return [name.strip() for name in names if name.strip()]


def _import(name: str, source: str) -> None:
    """Import a module by its path once."""
    if name in _loaded:
        return
    _loaded.add(name)  # before the import, in which registries may be asked
    try:
        if name.endswith('.py'):
            _import_file(Path(name))
        else:
            import_module(name)
    except (ImportError, OSError, SyntaxError) as error:
        raise ConfigError(
            f'{source} is {name!r}: expected a module that can be imported ({error})'
        ) from error


def _import_file(path: Path) -> None:
    """Import a Python file as a module of its own name, unless a program has imported it."""
    imported_from = getattr(sys.modules.get(path.stem), '__file__', None)
    if imported_from is not None and path.is_file() and path.samefile(imported_from):
        return
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise FileNotFoundError(f'{path} is no file')
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
