"""A plug-in: a term of the reward."""

from shepherd_ros.sim.reward import REWARD_TERMS, RewardTerm, Step
import torch
from torch import Tensor


def path(step: Step, weight: float) -> Tensor:
    """Return what the way of a team costs, mean over its shepherds; (...)."""
    before, after = step.before, step.after
    direction = torch.linalg.vector_norm(after.shepherds - before.shepherds, dim=-1)
    direction = (direction * after.shepherd_mask).sum(dim=-1) / after.team_size
    return -weight * direction / step.episode_steps


REWARD_TERMS.add(RewardTerm('path', 'cost of a meter of way, mean over shepherds', path, low=0.0))
