"""Errors of bags: the file, its fault, and the fix."""

from __future__ import annotations

from pathlib import Path

from shepherd_ros.config import ConfigError

RECOVER_HINT = 'run `shepherd bag recover {path}` to keep what can be read'


class BagError(ConfigError):
    """A bag that cannot be read or written: its path, what is wrong, and what to do."""

    def __init__(self, path: Path | str, what: str, fix: str = RECOVER_HINT) -> None:
        """Make the sentence; {path} in fix stands for the path."""
        self.path, self.what = Path(path), what
        super().__init__(f'{path}: {what}; {fix.replace("{path}", str(path))}')


class DamageError(ValueError):
    """Bytes of a file that are not what they should be: where, and what was expected."""

    def __init__(self, offset: int, what: str) -> None:
        """Take the offset [bytes] in the file and what is wrong there."""
        self.offset, self.what = offset, what
        super().__init__(f'{what} at byte {offset}')


def unreadable(path: Path, error: OSError) -> BagError:
    """Return the error for a file that cannot be opened."""
    reason = error.strerror or type(error).__name__
    return BagError(path, f'it cannot be read ({reason})', 'check the path and who may read it')
