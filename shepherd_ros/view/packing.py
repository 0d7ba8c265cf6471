"""Numbers for a page: rounded to 16 bits, compressed, written as text that JavaScript unpacks."""

from __future__ import annotations

from base64 import b64encode
import math
from typing import Any
import zlib

import numpy as np
from numpy.typing import NDArray

FREE_RAY = 65535  # stands for a free ray
MAX_CODE = FREE_RAY - 1  # largest number that is rounded to 16 bits
ZLIB_LEVEL = 6  # of zlib: higher ones take longer and gain little


def quantum(extent: float) -> float:
    """Return a round step that covers 0 .. extent with the numbers 0 .. MAX_CODE."""
    if extent <= 0:
        return 0.001
    decade = 10.0 ** math.floor(math.log10(extent / MAX_CODE))
    steps = (float(f'{factor * decade:.6g}') for factor in (1, 2, 5, 10, 20))
    return next(step for step in steps if step * MAX_CODE >= extent)


def packed(values: NDArray[Any]) -> dict[str, Any]:
    """Return an array as plain data: its type, its shape, and its bytes (zlib, base64)."""
    little = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder('<'))
    data = b64encode(zlib.compress(little.tobytes(), ZLIB_LEVEL)).decode('ascii')
    return {'type': values.dtype.name, 'shape': list(values.shape), 'data': data}


def rounded(values: NDArray[Any], low: float, step: float) -> dict[str, Any]:
    """Return values as packed uint16 k, each low + k step; FREE_RAY where not finite."""
    finite = np.isfinite(values)
    whole = np.full(values.shape, FREE_RAY, np.uint16)
    metres = values[finite].astype(np.float64)
    whole[finite] = np.rint((metres - low) / step).clip(0, MAX_CODE)
    return packed(whole) | {'low': low, 'step': step}
