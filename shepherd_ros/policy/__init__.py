"""The network of a learned shepherd, its checkpoints, and its use within an episode."""

__all__ = ['card', 'checkpoint', 'inference', 'network', 'policy', 'torchscript']
