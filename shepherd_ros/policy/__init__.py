"""The network of a learned shepherd, its checkpoints, and inference within an episode."""

__all__ = [
    'card', 'checkpoint', 'inference', 'network', 'policy', 'record_rows', 'timing', 'torchscript',
    'warm_start',
]  # fmt: skip
