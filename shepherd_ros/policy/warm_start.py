"""Weights of one policy as the first ones of another."""

from __future__ import annotations

from shepherd_ros.policy.policy import Policy
import torch


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
