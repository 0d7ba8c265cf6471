"""Max-pooling and ReLU in one, compiled for the CPU."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np
from shepherd_ros.sim.kernels import AVAILABLE, compiled
import torch
from torch import Tensor

WINDOW = 5
DEAD = WINDOW  # the winner where no value is above zero: nobody gets the gradient
INTEGER = {torch.bfloat16: torch.int16, torch.float32: torch.int32}


@compiled
def _pool(x, out, winner):
    """
    Pool the bits of floats x (R, W, C) to out (R, P, C) and the index of the winner.

    Floats above zero are in the same order as their bits, and the others have no say.
    """
    for r in range(out.shape[0]):
        for p in range(out.shape[1]):
            for c in range(out.shape[2]):
                best, who = x[r, p * WINDOW, c], 0
                for j in range(1, WINDOW):
                    value = x[r, p * WINDOW + j, c]
                    if value > best:
                        best, who = value, j
                out[r, p, c] = max(best, 0)
                winner[r, p, c] = who if best > 0 else DEAD


@compiled
def _spread(gradient, winner, out):
    """Give the bits of gradient (R, P, C) to the winners in out (R, W, C), zero to the others."""
    for r in range(out.shape[0]):
        for p in range(gradient.shape[1]):
            for j in range(WINDOW):
                for c in range(gradient.shape[2]):
                    mine = winner[r, p, c] == j
                    out[r, p * WINDOW + j, c] = gradient[r, p, c] if mine else 0
        for w in range(gradient.shape[1] * WINDOW, out.shape[1]):
            for c in range(gradient.shape[2]):
                out[r, w, c] = 0


def _bits(tensor: Tensor) -> np.ndarray:
    """Return the bits of a contiguous float tensor as an array of integers."""
    return tensor.detach().view(INTEGER[tensor.dtype]).numpy()


def usable(x: Tensor) -> bool:
    """Return whether the compiled form exists for a tensor."""
    return AVAILABLE and x.device.type == 'cpu' and x.dtype in INTEGER


def pool(x: Tensor) -> tuple[Tensor, Tensor]:
    """Return the pooled (B, W // 5, C) of a contiguous x (B, W, C) and who won."""
    batch, width, channels = x.shape
    out = x.new_empty(batch, width // WINDOW, channels)
    winner = torch.empty(out.shape, dtype=torch.uint8, device='cpu')
    _pool(_bits(x), _bits(out), winner.numpy())
    return out, winner


def spread(gradient: Tensor, winner: Tensor, width: int) -> Tensor:
    """Return the gradient (B, width, C) of what was pooled from that (B, P, C) of the result."""
    out = gradient.new_empty(gradient.shape[0], width, gradient.shape[2])
    _spread(_bits(gradient.contiguous()), winner.numpy(), _bits(out))
    return out
