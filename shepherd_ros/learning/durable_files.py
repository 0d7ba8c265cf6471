"""Atomic writing of files: complete or as before, also after a failure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import os
from pathlib import Path
from typing import Any

from shepherd_ros.config import ConfigError


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Raise ConfigError for an error while a file is written."""
    try:
        yield
    except (OSError, RuntimeError) as error:  # torch and a full disk: the second
        raise ConfigError(
            f'{path} cannot be written ({error!s:.200}): expected a folder with room; what was '
            'there is kept, and the same command goes on from it'
        ) from error


def replace_file(path: Path, write: Callable[[Any], object]) -> None:
    """Write a file under another name and rename it: the old one stays until then."""
    temporary = path.with_suffix('.part')
    with writing(path):
        try:
            with temporary.open('wb') as file:
                write(file)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
        folder = os.open(path.parent, os.O_RDONLY)
        os.fsync(folder)
        os.close(folder)
