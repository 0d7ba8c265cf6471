"""Distributed training: the processes of torchrun, each a rank; or a single one."""

from __future__ import annotations

import atexit
from collections.abc import Iterable
from datetime import timedelta
import os
from typing import Any

GROUP_TIMEOUT = timedelta(days=30)  # that one rank may wait for another


def rank() -> int:
    """Return the rank of this process among those of torchrun, over all machines."""
    return int(os.environ.get('RANK', '0'))


def ranks() -> int:
    """Return the number of processes of torchrun over all machines, 1 without it."""
    return int(os.environ.get('WORLD_SIZE', '1'))


def device_index() -> int:
    """Return the index of the GPU of this process on its machine."""
    return int(os.environ.get('LOCAL_RANK', '0'))


def barrier() -> None:
    """Wait until every process has called it; return at once with a single process."""
    if ranks() > 1:
        _distributed().barrier()


def total(number: float) -> float:
    """Return the sum of a number over all processes."""
    return number if ranks() == 1 else float(_reduced([number], 'SUM')[0])


def least(number: int) -> int:
    """Return the smallest of a number over all processes."""
    return number if ranks() == 1 else int(_reduced([number], 'MIN')[0])


def gather(value: bytes) -> list[bytes]:
    """Return the values of all processes in order, on the first; [] on the others."""
    parts: Any = [None] * ranks() if rank() == 0 else None
    _distributed().gather_object(value, parts)
    return parts or []


def broadcast(value: Any) -> Any:
    """Return the value of the first process."""
    box = [value]
    if ranks() > 1:
        _distributed().broadcast_object_list(box)
    return box[0]


def all_reduce(tensors: Iterable[Any]) -> None:
    """Replace float tensors by their sums over all processes, in place."""
    if ranks() == 1:
        return
    import torch

    tensors = list(tensors)
    flat = torch.cat([tensor.reshape(-1) for tensor in tensors])
    _distributed().all_reduce(flat)
    for tensor, part in zip(tensors, flat.split([t.numel() for t in tensors]), strict=True):
        tensor.copy_(part.view_as(tensor))


def _reduced(numbers: list[float], operation: str) -> Any:
    import torch

    distributed = _distributed()
    values = torch.tensor(numbers, dtype=torch.float64)
    distributed.all_reduce(values, getattr(distributed.ReduceOp, operation))
    return values


def _leave_group(distributed: Any) -> None:
    """End the threads of the group while Python runs; as it ends they may abort the process."""
    if distributed.is_initialized():
        distributed.destroy_process_group()


def _distributed() -> Any:
    """Return torch.distributed with all processes in a group, which is made the first time."""
    from torch import cuda, distributed

    if not distributed.is_initialized():
        kinds = 'cpu:gloo,cuda:nccl' if cuda.is_available() else 'gloo'
        distributed.init_process_group(kinds, timeout=GROUP_TIMEOUT)
        if kinds == 'gloo':  # that of NCCL waits for others, who may have failed
            atexit.register(_leave_group, distributed)
    return distributed
