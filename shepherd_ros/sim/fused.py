"""
Laws that torch compiles into a few kernels where they run on a GPU.

The law stays one, in plain torch: what is compiled is the plain function itself. Many small
operations over all pairs of a flock, or over all rays and discs, are meant to become few passes
over memory; not tried on a GPU yet. Off with the environment variable SHEPHERD_ROS_PLAIN=1.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
import os
from typing import Any

import torch
from torch import Tensor

_PLAIN = os.environ.get('SHEPHERD_ROS_PLAIN') == '1'


def fusible(tensor: Tensor) -> bool:
    """Return whether torch compiles functions of this tensor: it is on a GPU."""
    return not _PLAIN and tensor.device.type == 'cuda'


@cache
def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    return torch.compile(function)


def fused(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function, compiled at its first call whose first argument is on a GPU."""

    @wraps(function)
    def call(first: Tensor, *rest: Any) -> Any:
        return (_compiled(function) if fusible(first) else function)(first, *rest)

    return call
