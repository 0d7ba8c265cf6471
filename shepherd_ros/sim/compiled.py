"""
Compiled forms of the heaviest laws for float32 on the CPU, tested equal to the plain ones.

Optional: used where numba is installed, unless the environment variable SHEPHERD_ROS_PLAIN is 1.
Each stands behind the plain function that says what it computes, and computes one world after
another, so that a batch gives the same numbers as each world alone.
"""

from __future__ import annotations

from collections.abc import Callable
import os
from typing import Any

import numpy as np
import torch
from torch import Tensor

try:
    from numba import njit
except ImportError:  # numba is optional
    njit = None

HAS_NUMBA = njit is not None and os.environ.get('SHEPHERD_ROS_PLAIN') != '1'


def compilable(*tensors: Tensor) -> bool:
    """Return whether a compiled form exists for these tensors."""
    return HAS_NUMBA and all(
        t.dtype == torch.float32 and t.device.type == 'cpu' and not t.requires_grad
        for t in tensors
    )


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function compiled at its first call, kept on disk; itself without numba."""
    if njit is None:
        return function
    return njit(cache=True, nogil=True, error_model='numpy')(function)  # x / 0 as in torch


@compiled
def _start() -> int:
    return 0


def start_numba() -> None:
    """Start numba, which takes half a second, so that no later call waits for it."""
    if HAS_NUMBA:
        _start()


def flat_array(tensor: Tensor, keep: int) -> np.ndarray:
    """Return a tensor as a contiguous array: one leading axis, then its last `keep` axes."""
    array: np.ndarray = tensor.numpy()
    return np.ascontiguousarray(array.reshape(-1, *array.shape[array.ndim - keep :]))
