"""Setting of the C library that keeps freed memory for the next tensor."""

from __future__ import annotations

import ctypes

TRIM_THRESHOLD, TOP_PAD, MMAP_THRESHOLD = -1, -2, -3  # of glibc's mallopt
GIGABYTE = 1 << 30


def keep_memory() -> bool:
    """
    Keep freed memory; return whether that works, as only glibc can.

    A minibatch takes tens of megabytes and frees them again; fresh pages for each take as long as
    the work on them.
    """
    try:
        tell = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    return bool(
        tell(MMAP_THRESHOLD, GIGABYTE) and tell(TRIM_THRESHOLD, 2 * GIGABYTE - 1)
        and tell(TOP_PAD, GIGABYTE // 4)
    )  # fmt: skip
