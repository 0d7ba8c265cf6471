"""Errors of bags: the file, its fault, and the fix."""

from __future__ import annotations

from pathlib import Path

from shepherd_ros.config import ConfigError

RECOVER_HINT = 'run `shepherd bag recover {path}` to keep what can be read'


class BagError(ConfigError):
    """A bag that cannot be read or written: its path, the reason and the fix."""

    def __init__(self, path: Path | str, reason: str, fix: str = RECOVER_HINT) -> None:
        """Build the message; {path} in fix stands for the path."""
        self.path, self.reason = Path(path), reason
        super().__init__(f'{path}: {reason}; {fix.replace("{path}", str(path))}')


class DamageError(ValueError):
    """Damaged bytes of a file: the offset and the reason."""

    def __init__(self, offset: int, reason: str) -> None:
        """Build the message from the offset [bytes] in the file and the reason."""
        self.offset, self.reason = offset, reason
        super().__init__(f'{reason} at byte {offset}')


def unreadable(path: Path, error: OSError) -> BagError:
    """Return the error for a file that cannot be opened."""
    reason = error.strerror or type(error).__name__
    return BagError(path, f'it cannot be read ({reason})', 'check the path and who may read it')
