"""Files that are whole or as before, whatever happens while they are written."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import os
from pathlib import Path
from typing import Any

from shepherd_ros.config import ConfigError


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Raise ConfigError for what goes wrong while a file is written."""
    try:
        yield
    except (OSError, RuntimeError) as error:  # torch and a full disk: the second
        raise ConfigError(
            f'{path} cannot be written ({error!s:.200}): expected a folder with room; what was '
            'there is kept, and the same command goes on from it'
        ) from error


def replace_file(path: Path, write: Callable[[Any], object]) -> None:
    """Write a file beside and move it into place: the one before stays until it is whole."""
    beside = path.with_suffix('.part')
    with writing(path):
        try:
            with beside.open('wb') as file:
                write(file)
                file.flush()
                os.fsync(file.fileno())
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)
        folder = os.open(path.parent, os.O_RDONLY)
        os.fsync(folder)
        os.close(folder)
