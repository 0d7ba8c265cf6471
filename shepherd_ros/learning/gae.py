"""Generalised advantage estimation (Schulman et al. 2016)."""

from __future__ import annotations

import torch
from torch import Tensor


def advantages(
    reward: Tensor,
    value: Tensor,
    next_value: Tensor,
    ended: Tensor,
    gamma: float,
    gae_lambda: float,
) -> Tensor:
    """
    Return the advantage of each decision; all are (T, ...), time first.

    next_value is that of the state that follows in the same episode, also where a time limit
    ends it (ended True), so that limits are bootstrapped; after a terminal state it is 0.
    Advantages do not reach over the end of an episode.
    """
    result = torch.empty_like(value)
    carry = torch.zeros_like(value[0])
    error = reward + gamma * next_value - value
    for t in reversed(range(len(value))):
        carry = error[t] + gamma * gae_lambda * torch.where(ended[t], 0.0, carry)
        result[t] = carry
    return result
