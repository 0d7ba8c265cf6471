"""Perception: the true state with noise on positions."""

from __future__ import annotations

from dataclasses import replace

from shepherd_ros.sim.rng import normal, Stream
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor


def perceive(state: WorldState, noise_std: float) -> WorldState:
    """
    Return the state with independent N(0, noise_std^2) [m] on each coordinate of each position.

    Drawn anew each step, for goal, sheep and shepherds (paper, section 5). The noise follows from
    seed and step alone, so all lidars and controllers of one step see the same perceived state,
    wherever they run.
    """
    if noise_std == 0:
        return state

    def noisy(stream: Stream, position: Tensor) -> Tensor:
        index = torch.arange(position.shape[-2] * 2, device=position.device)
        draws = normal(state.seed, state.step, stream, index, position.dtype)
        return position + noise_std * draws.unflatten(-1, (-1, 2))

    return replace(
        state,
        goal=noisy(Stream.GOAL_NOISE, state.goal[..., None, :])[..., 0, :],
        sheep=noisy(Stream.SHEEP_NOISE, state.sheep),
        shepherds=noisy(Stream.SHEPHERD_NOISE, state.shepherds),
    )
