"""Judgement of a clone without a simulator: its error on bags that it does not learn from."""

from __future__ import annotations

from collections.abc import Iterable

from shepherd_ros.learning.clone import cut_to
from shepherd_ros.policy.policy import Policy
import torch
from torch import Tensor

BATCH_SIZE = 512
ExampleBatch = tuple[Tensor, Tensor, Tensor, Tensor]  # frames, first ray, target, hold


def is_held_out(index: int, share: float) -> bool:
    """Return whether a bag is held out, by its place in the order: evenly spread."""
    return int((index + 1) * share) > int(index * share)


@torch.no_grad()
def held_out_results(
    policy: Policy, batches: Iterable[ExampleBatch], clip_speed: float, dtype: torch.dtype
) -> dict[str, float]:
    """
    Return the mean error of the action [m/s], cut as in training, and what the gate gets right.

    The action is the mean of the mode that the gate chooses, as the policy acts. Without an
    example it is {}.
    """
    actor, count, error, right = policy.actor, 0, 0.0, 0.0
    for batch in batches:
        for frames, first, target, hold in zip(*(x.split(BATCH_SIZE) for x in batch), strict=True):
            out = actor.outputs(policy.arrange(frames.to(dtype), first))
            mean = cut_to(actor.action_of(out)[0], clip_speed)
            error += float(torch.linalg.vector_norm(mean - target, dim=-1).sum())
            chosen = actor.hold(out)
            right += 0.0 if chosen is None else float((chosen == hold).sum())
            count += len(first)
    if not count:
        return {}
    gate = {'gate_accuracy': right / count} if policy.config.network.modes == 2 else {}
    return {'held_out_error': error / count, **gate}
