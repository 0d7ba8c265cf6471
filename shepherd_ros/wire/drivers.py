"""The content of the topic drivers: JSON that conforms to msg_schemas/drivers.schema.json."""

from __future__ import annotations

from dataclasses import asdict, dataclass
import json
from typing import Any

from shepherd_ros.config import checked, ConfigError, mapping
from shepherd_ros.wire.episode import INT64

_NUMBERS = {'episode': 0, 'step': 0, 'stamp': 0}


@dataclass(frozen=True)
class Drivers:
    """
    The source that drives each shepherd (H) in a step of an episode.

    A driver is None where zero is commanded, as the shepherd is locked or its source silent. What
    is selected is a source, or auto for priorities. A later message on a step replaces an earlier
    one.
    """

    episode: int  # its number
    step: int
    stamp: int  # of the state that is answered [ns]
    drivers: tuple[str | None, ...]
    selected: tuple[str, ...]
    locked: tuple[bool, ...]

    @property
    def stamp_ns(self) -> int:
        """Return the stamp, as contents of other messages have it."""
        return self.stamp

    def to_json(self) -> str:
        """Return the content of the topic."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Drivers:
        """Return the drivers, or raise ConfigError that says what is wrong with the text."""
        try:
            data = mapping('drivers', json.loads(text))
            limits = {'low': 0, 'high': INT64}
            numbers = {name: checked(name, data[name], 0, limits) for name in _NUMBERS}
            drivers = _items(data['drivers'], (str, type(None)))
            selected, locked = _items(data['selected'], (str,)), _items(data['locked'], (bool,))
            if not len(drivers) == len(selected) == len(locked):
                raise ConfigError('drivers, selected and locked are not of one length')
            return cls(**numbers, drivers=drivers, selected=selected, locked=locked)
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            reason = str(error) if isinstance(error, ConfigError) else repr(error)
            raise ConfigError(
                f'drivers {text[:60]!r} cannot be read ({reason:.200}): expected JSON as in '
                'msg_schemas/drivers.schema.json'
            ) from error


def _items(value: Any, kinds: tuple[type, ...]) -> tuple[Any, ...]:
    """Return a list of items of some types as a tuple, or raise TypeError."""
    if not isinstance(value, list) or not all(isinstance(item, kinds) for item in value):
        raise TypeError(f'{value!r:.60}: expected a list')
    return tuple(value)
