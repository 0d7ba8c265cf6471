"""
Binary frames of the console: a state of the world in float32, little endian.

A frame is a header of 64 bytes and then float32 values, so that JavaScript reads it with a
DataView and one Float32Array at offset 64.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import struct
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Floats = NDArray[np.float32]
STATE_FRAME = 1  # kind of the frame
NO_SHEPHERD = -1  # whose lidar it is, if there is none
NO_DRIVER = -1.0  # driver of a shepherd that no mux tells of
# name, code of struct, meaning; in this order at the beginning of a frame
HEADER_FIELDS = (
    ('kind', 'I', '1: a state of the world'),
    ('number', 'I', 'number of the frame, which command `ack` returns'),
    ('time', 'd', 'stamp of the state [s]'),
    ('episode', 'I', 'number of the episode'),
    ('step', 'I', 'step of the state in its episode'),
    ('n_sheep', 'I', 'N'),
    ('n_shepherds', 'I', 'H'),
    ('lidar', 'i', 'shepherd whose ranges follow; -1: none'),
    ('n_channels', 'I', 'C, 0 without ranges'),
    ('n_rays', 'I', 'R, 0 without ranges'),
    ('goal_x', 'f', 'center of the goal region [m]'),
    ('goal_y', 'f', 'center of the goal region [m]'),
    ('goal_radius', 'f', 'radius of the goal region [m]'),
    ('origin_x', 'f', 'where the rays begin [m]: the shepherd when it was scanned'),
    ('origin_y', 'f', 'where the rays begin [m]'),
)
# name, shape, meaning; float32, in this order after the header
BODY_FIELDS = (
    ('sheep', '(N, 2)', 'positions [m]'),
    ('sheep_heading', '(N, 2)', 'unit vectors'),
    ('in_goal', '(N)', '1 in the goal region, else 0'),
    ('shepherds', '(H, 2)', 'positions [m]'),
    ('shepherd_heading', '(H, 2)', 'unit vectors, direction of the last move'),
    ('driver', '(H)', 'index in `sources` of the message `drivers`; -1: not known'),
    ('ranges', '(C, R)', 'ranges [m], +inf on free rays; ray k points along 2 pi k / R'),
)
_HEADER = struct.Struct('<' + ''.join(code for _, code, _ in HEADER_FIELDS))
HEADER_BYTES = _HEADER.size
NUMBER_OFFSET = 4  # [bytes] in front of the number of a frame


def _nothing() -> _Floats:
    return np.zeros((0, 0), np.float32)


@dataclass(frozen=True, eq=False)
class StateFrame:
    """A state of the world with the ranges of one lidar; shapes as in BODY_FIELDS."""

    time: float  # s
    episode: int
    step: int
    sheep: ArrayLike
    sheep_heading: ArrayLike
    shepherds: ArrayLike
    shepherd_heading: ArrayLike
    driver: ArrayLike
    goal: tuple[float, float]  # m
    goal_radius: float  # m
    lidar: int = NO_SHEPHERD
    origin: tuple[float, float] = (0.0, 0.0)  # m
    ranges: ArrayLike = field(default_factory=_nothing)
    number: int = 0

    @property
    def in_goal(self) -> _Floats:
        """Return 1 for each sheep in the goal region, else 0; (N,)."""
        offset = np.asarray(self.sheep, np.float32) - np.array(self.goal, np.float32)
        return (np.hypot(offset[:, 0], offset[:, 1]) <= self.goal_radius).astype(np.float32)

    def encode(self) -> bytes:
        """Return the bytes of the frame."""
        body = [np.asarray(getattr(self, name), '<f4') for name, _, _ in BODY_FIELDS]
        channels, rays = body[-1].shape
        head = _HEADER.pack(
            STATE_FRAME, self.number & 0xFFFFFFFF, self.time, self.episode & 0xFFFFFFFF, self.step,
            len(body[0]), len(body[3]), self.lidar, channels, rays, *self.goal, self.goal_radius,
            *self.origin,
        )  # fmt: skip
        return head + b''.join(part.tobytes() for part in body)


def numbered(frame: bytes, number: int) -> bytes:
    """Return the bytes of a frame with its number."""
    stamped = bytearray(frame)
    struct.pack_into('<I', stamped, NUMBER_OFFSET, number & 0xFFFFFFFF)
    return bytes(stamped)


def decode_frame(raw: bytes) -> StateFrame:
    """Return the frame that bytes hold; ValueError if they are none."""
    if len(raw) < HEADER_BYTES:
        raise ValueError(f'{len(raw)} bytes: expected at least {HEADER_BYTES}')
    values = _HEADER.unpack_from(raw)
    head = {name: value for (name, _, _), value in zip(HEADER_FIELDS, values, strict=True)}
    n, h, c, r = (head[name] for name in ('n_sheep', 'n_shepherds', 'n_channels', 'n_rays'))
    shapes = ((n, 2), (n, 2), (n,), (h, 2), (h, 2), (h,), (c, r))
    sizes = [int(np.prod(shape)) for shape in shapes]
    wanted = HEADER_BYTES + 4 * sum(sizes)
    if head['kind'] != STATE_FRAME or len(raw) != wanted:
        raise ValueError(
            f'{len(raw)} bytes of kind {head["kind"]}: expected {wanted} of kind {STATE_FRAME}'
        )
    numbers = np.frombuffer(raw, '<f4', offset=HEADER_BYTES)
    parts = np.split(numbers, np.cumsum(sizes)[:-1])
    body: dict[str, Any] = {
        name: part.reshape(shape)
        for (name, _, _), part, shape in zip(BODY_FIELDS, parts, shapes, strict=True)
        if name != 'in_goal'
    }
    frame = StateFrame(
        time=head['time'], episode=head['episode'], step=head['step'], lidar=head['lidar'],
        goal=(head['goal_x'], head['goal_y']), goal_radius=head['goal_radius'],
        origin=(head['origin_x'], head['origin_y']), **body,
    )  # fmt: skip
    return replace(frame, number=head['number'])
