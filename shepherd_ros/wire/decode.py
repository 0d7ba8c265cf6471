"""
Decoding of the contract's messages from CDR to numbers, without ROS.

Every function takes the bytes of one message and raises CdrError if they are no such message.
Arrays may share the memory of the message and must not be written to.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ranges = NDArray[np.float32]
HEADER = 4  # [bytes] of encapsulation in front of every message
SECOND = 1_000_000_000  # [ns]
FRAME_OFFSET = 16  # [bytes] in front of the frame of a std_msgs/Header
SCAN_OFFSET = 32  # [bytes] of a sensor_msgs/LaserScan from its header to its ranges


class CdrError(ValueError):
    """Bytes that are no message of the expected type."""


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
    angle_max: float
    angle_increment: float
    range_min: float
    range_max: float
    ranges: Ranges


class Vector(NamedTuple):
    """A velocity [m/s] or a position [m] in the plane; stamp None if it has none."""

    stamp_ns: int | None
    frame_id: str
    x: float
    y: float

    @property
    def xy(self) -> Floats:
        """Return x and y as an array (2,)."""
        return np.array((self.x, self.y))


class Motion(NamedTuple):
    """A velocity in the plane [m/s] and a turn [rad/s]; stamp None if it has none."""

    stamp_ns: int | None
    frame_id: str
    x: float
    y: float
    turn: float


class _Order:
    """Readers of the parts of a message in one byte order."""

    def __init__(self, sign: str) -> None:
        def reader(form: str) -> Callable[[bytes, int], tuple[Any, ...]]:
            return struct.Struct(sign + form).unpack_from

        self.time, self.header, self.count = reader('iI'), reader('iII'), reader('I')
        self.pair, self.scan, self.number = reader('2d'), reader('7fI'), reader('d')
        self.twist, self.flag = reader('6d'), reader('?')
        self.float32, self.float64 = np.dtype(f'{sign}f4'), np.dtype(f'{sign}f8')


_ORDERS = {b'\x00\x01': _Order('<'), b'\x00\x00': _Order('>')}  # by what is in front


def _checked(read: Callable[[bytes, _Order], Any]) -> Callable[[bytes], Any]:
    """Return a decoder that raises CdrError for bytes that are no such message."""

    @wraps(read)
    def decode(raw: bytes) -> Any:
        try:
            return read(raw, _ORDERS[raw[:2]])
        except KeyError:
            reason = f'{raw[:HEADER].hex()} in front, expected plain CDR, 00010000'
        except UnicodeDecodeError:
            reason = 'a text that is no UTF-8'
        except (struct.error, ValueError) as error:
            reason = f'{len(raw)} bytes, {error}'
        raise CdrError(reason)

    return decode


def _text(raw: bytes, start: int, length: int) -> str:
    """Return a text whose first byte is at start."""
    if start + length > len(raw):
        raise ValueError(f'a text of {length} bytes, where {len(raw) - start} are left')
    return raw[start : start + length].removesuffix(b'\x00').decode()


def _header(raw: bytes, order: _Order) -> tuple[int, str, int]:
    """Return stamp [ns], frame and end of a std_msgs/Header."""
    sec, nanosec, length = order.header(raw, HEADER)
    return sec * SECOND + nanosec, _text(raw, FRAME_OFFSET, length), FRAME_OFFSET + length


@_checked
def decode_stamp(raw: bytes, order: _Order) -> int:
    """Return the stamp [ns] of a message that begins with a std_msgs/Header or a Time."""
    sec, nanosec = order.time(raw, HEADER)
    return int(sec * SECOND + nanosec)


@_checked
def decode_poses(raw: bytes, order: _Order) -> Poses:
    """Return a geometry_msgs/PoseArray."""
    stamp_ns, frame_id, offset = _header(raw, order)
    offset += -offset % 4
    (count,) = order.count(raw, offset)
    offset += 4 + -offset % 8 if count else 0  # offsets count after four bytes of encapsulation
    poses = np.frombuffer(raw, order.float64, 7 * count, offset).reshape(count, 7)
    heading = np.empty((count, 2))
    x, y, z, w = np.ascontiguousarray(poses[:, 3:].T)
    with np.errstate(all='ignore'):  # a quaternion may be anything
        heading[:, 0] = 1 - 2 * (y * y + z * z)
        heading[:, 1] = 2 * (w * z + x * y)
    return Poses(stamp_ns, frame_id, poses[:, :2].astype(np.float64), heading)


@_checked
def decode_scan(raw: bytes, order: _Order) -> Scan:
    """Return a sensor_msgs/LaserScan."""
    stamp_ns, frame_id, offset = _header(raw, order)
    offset += -offset % 4
    start, end, increment, _, _, low, high, count = order.scan(raw, offset)
    ranges = np.frombuffer(raw, order.float32, count, offset + SCAN_OFFSET)
    ranges = ranges.astype(np.float32, copy=False)
    return Scan(stamp_ns, frame_id, start, end, increment, low, high, ranges)


@_checked
def decode_twist_stamped(raw: bytes, order: _Order) -> Vector:
    """Return the velocity in the plane of a geometry_msgs/TwistStamped."""
    sec, nanosec, length = order.header(raw, HEADER)  # once for each command: no further calls
    offset = FRAME_OFFSET + length
    x, y = order.pair(raw, offset + (HEADER - offset) % 8)
    frame_id = raw[FRAME_OFFSET:offset].removesuffix(b'\x00').decode()
    return Vector(sec * SECOND + nanosec, frame_id, x, y)


@_checked
def decode_twist(raw: bytes, order: _Order) -> Vector:
    """Return the velocity in the plane of a geometry_msgs/Twist, which has no stamp."""
    return Vector(None, '', *order.pair(raw, HEADER))


@_checked
def decode_motion(raw: bytes, order: _Order) -> Motion:
    """Return velocity and turn of a geometry_msgs/Twist, which has no stamp."""
    x, y, _, _, _, turn = order.twist(raw, HEADER)
    return Motion(None, '', x, y, turn)


@_checked
def decode_motion_stamped(raw: bytes, order: _Order) -> Motion:
    """Return velocity and turn of a geometry_msgs/TwistStamped."""
    stamp_ns, frame_id, at = _header(raw, order)
    x, y, _, _, _, turn = order.twist(raw, at + (HEADER - at) % 8)
    return Motion(stamp_ns, frame_id, x, y, turn)


@_checked
def decode_bool(raw: bytes, order: _Order) -> bool:
    """Return the value of a std_msgs/Bool."""
    return bool(order.flag(raw, HEADER)[0])


@_checked
def decode_string(raw: bytes, order: _Order) -> str:
    """Return the text of a std_msgs/String."""
    return _text(raw, HEADER + 4, *order.count(raw, HEADER))


@_checked
def decode_float64(raw: bytes, order: _Order) -> float:
    """Return the number of a std_msgs/Float64."""
    return float(order.number(raw, HEADER)[0])


decode_clock = decode_stamp  # a rosgraph_msgs/Clock is a Time
decode_pose_stamped = decode_twist_stamped  # they begin alike: header, then x and y in float64

DECODERS: dict[str, Callable[[bytes], Any]] = {
    'geometry_msgs/msg/PoseArray': decode_poses,
    'geometry_msgs/msg/PoseStamped': decode_pose_stamped,
    'geometry_msgs/msg/Twist': decode_twist,
    'geometry_msgs/msg/TwistStamped': decode_twist_stamped,
    'rosgraph_msgs/msg/Clock': decode_clock,
    'sensor_msgs/msg/LaserScan': decode_scan,
    'std_msgs/msg/Bool': decode_bool,
    'std_msgs/msg/Float64': decode_float64,
    'std_msgs/msg/String': decode_string,
}
