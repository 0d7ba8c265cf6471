"""Parts of a sweep for the processes that torchrun starts, on one machine or on several."""

from __future__ import annotations

from datetime import timedelta
import os

LONG = timedelta(days=30)  # that one rank may wait for another


def torchrun_shard() -> str:
    """Return the part i/n of this process, 1/1 where torchrun has not started it."""
    return f'{rank() + 1}/{os.environ.get("WORLD_SIZE", "1")}'


def rank() -> int:
    """Return which of torchrun's processes this is, counted from 0 over all machines."""
    return int(os.environ.get('RANK', '0'))


def wait_for_all() -> None:
    """Return when every process of torchrun has come here; at once where there is one."""
    if 'RANK' not in os.environ or os.environ.get('WORLD_SIZE') == '1':
        return
    from torch import distributed

    distributed.init_process_group('gloo', timeout=LONG)
    try:
        distributed.barrier()
    finally:
        distributed.destroy_process_group()
