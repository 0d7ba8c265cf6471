"""Page of the protocol between console and page."""

from __future__ import annotations

from shepherd_ros.console.commands import COMMAND_KINDS, CommandField
from shepherd_ros.console.desk import PROTOCOL
from shepherd_ros.console.messages import MESSAGE_KINDS
from shepherd_ros.console.state_frames import BODY_FIELDS, HEADER_BYTES, HEADER_FIELDS

from manual.tables import bounds, code, escaped, page, table

_CODES = {'I': ('uint32', 4), 'i': ('int32', 4), 'f': ('float32', 4), 'd': ('float64', 8)}
_INTRO = """
The page of the node `console` speaks with it over one websocket, at `/ws` of the address that the
node prints. Frames are binary and hold states; all else is JSON, one object a message.

1. The page opens the websocket, and gets `hello`, every latched message and the last state.
2. It gets a frame for each new state, at most two that it has not yet drawn: it sends `ack` with
   the number of each frame when that is drawn. A frame that is out of date is never sent, so a
   slow or hidden page has no backlog. The same holds for messages: of each type the newest is
   sent.
3. It sends commands as `{"do": NAME, "id": NUMBER, ...}`, with a number of its choice, and gets
   `answer` with that number. A command that cannot be done is answered in words.
4. While a person drives a shepherd it sends `drive`, 20 times a second, and `blur` when it is
   hidden or loses the focus. A shepherd whose page is silent, closed or blurred stops.

Files come from the same address: `/` is the page, `/NAME` a file of it or a result of a job. A
request with the Host or the Origin of another site is refused (403), and so is one without the
token where one is needed: as query `token`, or as the cookie that the first request sets.
"""


def console() -> str:
    """Return the page of the protocol."""
    return page(
        'Protocol of the console',
        _INTRO,
        f'This is version {PROTOCOL}, as `hello` says.',
        '## Frames',
        f'Little endian: a header of {HEADER_BYTES} bytes, then float32 values.',
        table(('offset', 'type', 'field', 'meaning'), _header()),
        'N sheep, H shepherds, C channels of R rays, as the header says:',
        table(
            ('values', 'shape', 'meaning'),
            [[code(name), shape, escaped(doc)] for name, shape, doc in BODY_FIELDS],
        ),
        '## Messages to the page',
        table(('type', 'latched', 'field', 'meaning'), _messages()),
        '## Commands of the page',
        table(('command', 'field', 'type', 'allowed', 'meaning'), _commands()),
    )


def _header() -> list[list[str]]:
    """Return a row for each field of the header."""
    rows, offset = [], 0
    for name, letter, doc in HEADER_FIELDS:
        kind, size = _CODES[letter]
        rows.append([str(offset), kind, code(name), escaped(doc)])
        offset += size
    return rows


def _messages() -> list[list[str]]:
    """Return a row for each message and each of its fields."""
    rows = []
    for name, kind in MESSAGE_KINDS.items():
        rows.append([code(name), 'yes' if kind.latched else 'no', '', escaped(kind.doc)])
        rows += [['', '', code(key), escaped(doc)] for key, doc in kind.fields.items()]
    return rows


def _commands() -> list[list[str]]:
    """Return a row for each command and each of its fields."""
    rows = []
    for name, kind in COMMAND_KINDS.items():
        rows.append([code(name), '', '', '', escaped(kind.doc)])
        rows += [_field(key, about) for key, about in kind.fields.items()]
    return rows


def _field(name: str, about: CommandField) -> list[str]:
    """Return the row of a field of a command."""
    kind = {'dict': 'object', 'str': 'text'}.get(about.about()['type'], about.about()['type'])
    doc = f'{about.doc} (may be left out)' if about.optional else about.doc
    allowed = bounds(about.low, about.high, about.choices)
    return ['', code(name), kind, allowed, escaped(doc)]
