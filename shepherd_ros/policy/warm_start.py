"""Weights of one policy as the first ones of another."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

from shepherd_ros.policy.policy import Policy
import torch
from torch import nn


def warm_start(policy: Policy, source: Policy, new_critic: bool = False) -> None:
    """
    Set the weights of a policy to those of another, or raise RuntimeError where they do not fit.

    new_critic: those of the critic stay. Where only the policy has two modes, both begin as the
    single one, and its gate is random.
    """
    state = source.state_dict()
    if policy.config.network.modes > source.config.network.modes:
        own = policy.state_dict()
        for name in ('actor.head.weight', 'actor.head.bias'):
            state[name] = torch.cat([state[name], state[name], own[name][-1:]])
        if 'actor.log_std' in state:
            state['actor.log_std'] = state['actor.log_std'].expand(2, 2)
    if new_critic:
        own = {f'critic.{name}': value for name, value in policy.critic.state_dict().items()}
        state = {name: own.get(name, value) for name, value in state.items()}
    policy.load_state_dict(state)


def drive_mode(policy: Policy) -> Policy:
    """Return a policy with the drive mode alone of one with two modes, others as they are."""
    if policy.config.network.modes == 1:
        return policy
    single = deepcopy(policy)
    single.config = replace(policy.config, network=replace(policy.config.network, modes=1))
    actor, head = single.actor, single.actor.head
    actor.config, head.out_features = single.config.network, actor.width
    head.weight = nn.Parameter(head.weight.detach()[: actor.width])
    head.bias = nn.Parameter(head.bias.detach()[: actor.width])
    if 'log_std' in dict(actor.named_parameters()):
        actor.log_std = nn.Parameter(actor.log_std.detach()[0])
    return single
