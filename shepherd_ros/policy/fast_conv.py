"""
A convolution, ReLU and pooling as one step, in a form that is fast on a CPU.

The same function as torch's own operations in turn (`plain_stage`), in another order: pooling
comes before ReLU, channels are last, and the gradient goes only to the winners.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

from typing import Any

import numpy as np
from shepherd_ros.sim.compiled import compiled, HAS_NUMBA
from shepherd_ros.sim.fused import fused
import torch
from torch import Tensor
from torch.nn import functional

POOL_SIZE = 5
NO_WINNER = POOL_SIZE  # the winner where no value is above zero: none gets the gradient
INTEGER_DTYPES = {torch.bfloat16: torch.int16, torch.float32: torch.int32}


@compiled
def _pool(x, out, winner):
    """
    Pool the bits of floats x (R, W, C) to out (R, P, C) and the index of the winner.

    Floats above zero are in the same order as their bits, and the others do not count.
    """
    for r in range(out.shape[0]):
        for p in range(out.shape[1]):
            for c in range(out.shape[2]):
                best, index = x[r, p * POOL_SIZE, c], 0
                for j in range(1, POOL_SIZE):
                    value = x[r, p * POOL_SIZE + j, c]
                    if value > best:
                        best, index = value, j
                out[r, p, c] = max(best, 0)
                winner[r, p, c] = index if best > 0 else NO_WINNER


@compiled
def _unpool(gradient, winner, out):
    """Write the bits of gradient (R, P, C) to the winners in out (R, W, C), zero elsewhere."""
    for r in range(out.shape[0]):
        for p in range(gradient.shape[1]):
            for j in range(POOL_SIZE):
                for c in range(gradient.shape[2]):
                    selected = winner[r, p, c] == j
                    out[r, p * POOL_SIZE + j, c] = gradient[r, p, c] if selected else 0
        for w in range(gradient.shape[1] * POOL_SIZE, out.shape[1]):
            for c in range(gradient.shape[2]):
                out[r, w, c] = 0


def _bits(tensor: Tensor) -> np.ndarray:
    """Return the bits of a contiguous float tensor as an array of integers."""
    return tensor.detach().view(INTEGER_DTYPES[tensor.dtype]).numpy()


def _compilable(x: Tensor) -> bool:
    """Return whether the compiled form exists for a tensor."""
    return HAS_NUMBA and x.device.type == 'cpu' and x.dtype in INTEGER_DTYPES


def pool(x: Tensor) -> tuple[Tensor, Tensor]:
    """Return the pooled (B, W // 5, C) of a contiguous x (B, W, C), and the winners' indices."""
    batch, width, channels = x.shape
    out = x.new_empty(batch, width // POOL_SIZE, channels)
    winner = torch.empty(out.shape, dtype=torch.uint8, device='cpu')
    _pool(_bits(x), _bits(out), winner.numpy())
    return out, winner


def unpool(gradient: Tensor, winner: Tensor, width: int) -> Tensor:
    """Return the gradient (B, width, C) of pool()'s input from that (B, P, C) of its output."""
    out = gradient.new_empty(gradient.shape[0], width, gradient.shape[2])
    _unpool(_bits(gradient.contiguous()), winner.numpy(), _bits(out))
    return out


@fused
def plain_stage(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """Return max over five neighbours of relu(conv(x)); (B, C, L) -> (B, F, (L - K + 1) // 5)."""
    x = functional.conv1d(x, weight.to(x.dtype), bias.to(x.dtype))
    return functional.max_pool1d(functional.relu(x), POOL_SIZE)


def first_stage(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """
    Return plain_stage() of an input that needs no gradient; (B, L, C) -> (B, P, F).

    weight is (F, C, K), bias (F).
    """
    if not _compilable(x):
        return plain_stage(x.transpose(1, 2), weight, bias).transpose(1, 2)
    return _FirstStage.apply(x, _window_weight(weight, bias).to(x.dtype))


def second_stage(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """Return plain_stage(); (B, L, C) -> (B, P, F); weight is (F, C, K), bias (F)."""
    if not _compilable(x):
        return plain_stage(x.transpose(1, 2), weight, bias).transpose(1, 2)
    flat = weight[:, :, None].to(x.dtype).contiguous(memory_format=torch.channels_last)
    return _SecondStage.apply(x.contiguous(), flat, bias.to(x.dtype))


def _window_weight(weight: Tensor, bias: Tensor) -> Tensor:
    """
    Return the matrix (5 F, (K + 4) C + 1) from a window of inputs and a one to five outputs.

    The outputs that are pooled together come from one window of K + 4 inputs; they differ in where
    the filter begins.
    """
    taps = weight.transpose(1, 2)  # (F, K, C)
    shifted = [
        functional.pad(taps, (0, 0, j, POOL_SIZE - 1 - j)).flatten(1) for j in range(POOL_SIZE)
    ]
    return torch.cat([torch.cat(shifted), bias.repeat(POOL_SIZE)[:, None]], dim=1)


class _FirstStage(torch.autograd.Function):
    """One product of matrices: good for few channels, where a convolution is slow."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor) -> Tensor:
        batch, length, channels = x.shape
        width = weight.shape[1] - 1
        count = length - width // channels + POOL_SIZE  # outputs before pooling
        windows = x.new_ones(batch, count // POOL_SIZE, width + 1)
        strides = (length * channels, POOL_SIZE * channels, 1)
        windows[..., :-1] = x.contiguous().as_strided((*windows.shape[:2], width), strides)
        windows = windows.flatten(0, 1)
        out = (windows @ weight.T).view(batch, -1, weight.shape[0] // POOL_SIZE)
        pooled, winner = pool(out)
        ctx.save_for_backward(windows, winner)
        return pooled

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[None, Tensor]:
        windows, winner = ctx.saved_tensors
        wide = unpool(gradients[0], winner, winner.shape[1] * POOL_SIZE)
        return None, (windows.T @ wide.view(len(windows), -1)).T


class _SecondStage(torch.autograd.Function):
    """A convolution with channels last in memory."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        out = functional.conv2d(x.transpose(1, 2)[:, :, None], weight, bias)
        out = out[:, :, 0].transpose(1, 2).contiguous()
        pooled, winner = pool(out)
        ctx.save_for_backward(x, weight, winner)
        ctx.width = out.shape[1]
        return pooled

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        x, weight, winner = ctx.saved_tensors
        wide = unpool(gradients[0], winner, ctx.width)
        grads = torch.ops.aten.convolution_backward(
            wide.transpose(1, 2)[:, :, None],
            x.transpose(1, 2)[:, :, None],
            weight,
            [weight.shape[0]],
            [1, 1],
            [0, 0],
            [1, 1],
            False,
            [0, 0],
            1,
            [True, True, True],
        )
        return grads[0][:, :, 0].transpose(1, 2), grads[1], grads[2]
