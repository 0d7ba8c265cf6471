"""
Registries: the entries of one kind by name, those of plug-ins among them.

A plug-in is a module that adds entries when it is imported. Installed packages name theirs by the
entry point group `shepherd_ros.plugins`; the environment variable SHEPHERD_ROS_PLUGINS names
others, by import path or as Python files, with commas between them. They are imported when a
registry is first asked, in every process alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from importlib.metadata import entry_points
import importlib.util
import os
from pathlib import Path
import sys
from typing import Generic, Protocol, TypeVar

from shepherd_ros.config import ConfigError, unknown_name

GROUP = 'shepherd_ros.plugins'
VARIABLE = 'SHEPHERD_ROS_PLUGINS'
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
        """Return whether there is an entry of that name."""
        load_plugins()
        return name in self._entries

    def __iter__(self) -> Iterator[str]:
        """Yield the names."""
        load_plugins()
        return iter(list(self._entries))

    def __len__(self) -> int:
        """Return the number of entries."""
        load_plugins()
        return len(self._entries)


def load_plugins() -> None:
    """Import the plug-ins that are not imported yet, or raise ConfigError."""
    installed = [] if GROUP in _loaded else entry_points(group=GROUP)
    _loaded.add(GROUP)
    for point in installed:
        _import(point.value, f'entry point {point.name!r} of group {GROUP}')
    for name in os.environ.get(VARIABLE, '').split(','):
        if name.strip():
            _import(name.strip(), VARIABLE)


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
    """Import a Python file as a module of its own name."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise FileNotFoundError(f'{path} is no file')
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
