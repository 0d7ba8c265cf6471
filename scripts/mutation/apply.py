"""A mutant in a running process: new code in living functions, or a changed module at import."""

from __future__ import annotations

from collections.abc import Iterator
import gc
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
import inspect
import sys
from types import CodeType, FunctionType

Pair = tuple[CodeType, CodeType]


def changed_functions(before: CodeType, after: CodeType) -> Iterator[Pair | None]:
    """Yield functions that differ, as code before and after; None where import itself differs."""
    inner = [part for part in before.co_consts if isinstance(part, CodeType)]
    other = [part for part in after.co_consts if isinstance(part, CodeType)]
    plain = [part for part in before.co_consts if not isinstance(part, CodeType)]
    rest = [part for part in after.co_consts if not isinstance(part, CodeType)]
    same = before.co_code == after.co_code and repr(plain) == repr(rest)
    if len(inner) != len(other) or not (same and before.co_names == after.co_names):
        yield (before, after) if before.co_flags & inspect.CO_OPTIMIZED else None
    for old, new in zip(inner, other, strict=False):
        if old != new:
            if old.co_flags & inspect.CO_OPTIMIZED:
                yield old, new
            yield from changed_functions(old, new)


def swap(path: str, before: str, after: str) -> bool:
    """Give the living functions of a file their changed code; return False where none lives."""
    pairs = list(changed_functions(*(compile(text, path, 'exec') for text in (before, after))))
    if None in pairs:
        return False
    swapped = False
    for function in [part for part in gc.get_objects() if isinstance(part, FunctionType)]:
        if function.__code__.co_filename == path:
            for old, new in (pair for pair in pairs if pair):
                if function.__code__ == old:
                    function.__code__, swapped = new, True
    return swapped


class _Loader(SourceFileLoader):
    """Loads a module from a text that is not that of its file."""

    text: str

    def get_code(self, name: str) -> CodeType:
        """Return the code of the text, which is kept nowhere."""
        return compile(self.text, self.path, 'exec')


class Changed(MetaPathFinder):
    """Lets one module be imported from a changed text."""

    def __init__(self, name: str, path: str, text: str) -> None:
        """Stand before all other finders."""
        self.loader = _Loader(name, path)
        self.loader.text = text
        sys.meta_path.insert(0, self)

    def find_spec(self, name: str, *_: object) -> ModuleSpec | None:
        """Return the spec of the changed module, None for all others."""
        if name != self.loader.name:
            return None
        return spec_from_file_location(name, self.loader.path, loader=self.loader)


def module_name(path: str) -> str:
    """Return the module of a path: shepherd_ros/sim/rng.py -> shepherd_ros.sim.rng."""
    return path.removesuffix('.py').removesuffix('/__init__').replace('/', '.')
