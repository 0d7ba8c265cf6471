"""The network of a learned shepherd, its checkpoints, and its use within an episode."""
