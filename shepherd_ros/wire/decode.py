"""
Messages of the contract from CDR to numbers, without ROS.

Every function takes the bytes of one message and raises CdrError if they are not what they should
be. Arrays may share the memory of the message and are not to be written to.
"""

from __future__ import annotations

from collections.abc import Callable
import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ranges = NDArray[np.float32]
HEADER = 4  # [bytes] of encapsulation in front of every message


class CdrError(ValueError):
    """Bytes that are no message of the type that they should be."""


class Poses(NamedTuple):
    """A geometry_msgs/PoseArray in the plane: positions (K, 2) m, headings (K, 2) unit vectors."""

    stamp_ns: int
    frame_id: str
    xy: Floats
    heading: Floats


class Scan(NamedTuple):
    """A sensor_msgs/LaserScan: ranges (R,) m, +inf for no return; angles in rad, range in m."""

    stamp_ns: int
    frame_id: str
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    ranges: Ranges


class Vector(NamedTuple):
    """A velocity (2,) m/s or a position (2,) m in the plane; stamp None if it has none."""

    stamp_ns: int | None
    frame_id: str
    xy: Floats


class _Cursor:
    """Reads one message from its front; offsets count after the encapsulation."""

    def __init__(self, raw: bytes) -> None:
        if len(raw) < HEADER or raw[0] != 0 or raw[1] > 1:
            raise CdrError(f'{raw[:HEADER].hex()} in front: expected plain CDR, 00010000')
        self.raw, self.at, self.order = raw, 0, '<' if raw[1] else '>'

    def take(self, form: str, size: int) -> tuple[Any, ...]:
        """Return the numbers of a struct format, aligned to the size of the first [bytes]."""
        self.at += -self.at % size
        form = self.order + form
        try:
            values = struct.unpack_from(form, self.raw, HEADER + self.at)
        except struct.error as error:
            raise CdrError(f'it ends after {len(self.raw)} bytes') from error
        self.at += struct.calcsize(form)
        return values

    def text(self) -> str:
        """Return a string."""
        return self._text(*self.take('I', 4))

    def _text(self, length: int) -> str:
        start = HEADER + self.at
        data = self.raw[start : start + length]
        if len(data) != length:
            raise CdrError(f'a text of {length} bytes, where {len(data)} are left')
        self.at += length
        try:
            return data.removesuffix(b'\x00').decode()
        except UnicodeDecodeError as error:
            raise CdrError('a text that is no UTF-8') from error

    def time(self) -> int:
        """Return a builtin_interfaces/Time in ns."""
        sec, nanosec = self.take('iI', 4)
        return int(sec * 10**9 + nanosec)

    def header(self) -> tuple[int, str]:
        """Return stamp [ns] and frame of a std_msgs/Header."""
        sec, nanosec, length = self.take('iII', 4)
        return sec * 10**9 + nanosec, self._text(length)

    def array(self, kind: str, count: int) -> NDArray[Any]:
        """Return count numbers as an array, aligned if there are any."""
        dtype = np.dtype(self.order + kind)
        if not count:
            return np.empty(0, dtype)
        self.at += -self.at % dtype.itemsize
        if HEADER + self.at + count * dtype.itemsize > len(self.raw):
            raise CdrError(f'{count} numbers: there are not so many')
        values = np.frombuffer(self.raw, dtype, count, HEADER + self.at)
        self.at += count * dtype.itemsize
        return values


def decode_stamp(raw: bytes) -> int:
    """Return the stamp [ns] of a message that begins with a std_msgs/Header or a Time."""
    return _Cursor(raw).time()


def decode_poses(raw: bytes) -> Poses:
    """Return a geometry_msgs/PoseArray."""
    cursor = _Cursor(raw)
    stamp_ns, frame_id = cursor.header()
    (count,) = cursor.take('I', 4)
    poses = cursor.array('f8', 7 * count).reshape(count, 7)
    heading = np.empty((count, 2))
    x, y, z, w = np.ascontiguousarray(poses[:, 3:].T)
    with np.errstate(all='ignore'):  # a quaternion may be anything
        heading[:, 0] = 1 - 2 * (y * y + z * z)
        heading[:, 1] = 2 * (w * z + x * y)
    return Poses(stamp_ns, frame_id, poses[:, :2].astype(np.float64), heading)


def decode_scan(raw: bytes) -> Scan:
    """Return a sensor_msgs/LaserScan."""
    cursor = _Cursor(raw)
    stamp_ns, frame_id = cursor.header()
    start, _, increment, _, _, low, high, count = cursor.take('7fI', 4)
    ranges = cursor.array('f4', count).astype(np.float32, copy=False)
    return Scan(stamp_ns, frame_id, start, increment, low, high, ranges)


def _plane(cursor: _Cursor) -> Floats:
    return np.array(cursor.take('2d', 8), np.float64)


def decode_twist_stamped(raw: bytes) -> Vector:
    """Return the velocity in the plane of a geometry_msgs/TwistStamped."""
    cursor = _Cursor(raw)
    stamp_ns, frame_id = cursor.header()
    return Vector(stamp_ns, frame_id, _plane(cursor))


def decode_twist(raw: bytes) -> Vector:
    """Return the velocity in the plane of a geometry_msgs/Twist, which has no stamp."""
    return Vector(None, '', _plane(_Cursor(raw)))


def decode_pose_stamped(raw: bytes) -> Vector:
    """Return the position in the plane of a geometry_msgs/PoseStamped."""
    return decode_twist_stamped(raw)  # they begin alike: header, then x and y in float64


def decode_string(raw: bytes) -> str:
    """Return the text of a std_msgs/String."""
    return _Cursor(raw).text()


def decode_clock(raw: bytes) -> int:
    """Return the time [ns] of a rosgraph_msgs/Clock."""
    return _Cursor(raw).time()


def decode_float64(raw: bytes) -> float:
    """Return the number of a std_msgs/Float64."""
    return float(_Cursor(raw).take('d', 8)[0])


DECODERS: dict[str, Callable[[bytes], Any]] = {
    'geometry_msgs/msg/PoseArray': decode_poses,
    'geometry_msgs/msg/PoseStamped': decode_pose_stamped,
    'geometry_msgs/msg/Twist': decode_twist,
    'geometry_msgs/msg/TwistStamped': decode_twist_stamped,
    'rosgraph_msgs/msg/Clock': decode_clock,
    'sensor_msgs/msg/LaserScan': decode_scan,
    'std_msgs/msg/Float64': decode_float64,
    'std_msgs/msg/String': decode_string,
}
