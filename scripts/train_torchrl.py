#!/usr/bin/env python3
"""Rollouts with TorchRL: a Gaussian actor for all shepherds in worlds behind a GymWrapper."""

import sys

from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import WorldConfig
import tyro

try:
    from shepherd_ros.integrations.environments import HerdingVectorEnv
    from tensordict.nn import TensorDictModule
    from torchrl.collectors import Collector
    from torchrl.envs import FlattenObservation, GymWrapper, TransformedEnv
    from torchrl.modules import MLP, NormalParamExtractor, ProbabilisticActor, TanhNormal
except ImportError as error:
    sys.exit(f"{error}; install it: pip install '.[envs]' torchrl")
from torch import nn


def main(worlds: int = 8, sheep: int = 10, shepherds: int = 2, steps: int = 50) -> None:
    """Collect an episode of each world and say what it gained, for a loss of torchrl."""
    config = EnvConfig(world=WorldConfig(sheep, shepherds, episode_steps=steps))
    env = GymWrapper(HerdingVectorEnv(config, worlds))
    env = TransformedEnv(env, FlattenObservation(-2, -1, in_keys=['observation']))
    net = nn.Sequential(MLP(out_features=4, num_cells=[64, 64]), NormalParamExtractor())
    module = TensorDictModule(net, in_keys=['observation'], out_keys=['loc', 'scale'])
    actor = ProbabilisticActor(module, in_keys=['loc', 'scale'], distribution_class=TanhNormal)
    actor(env.reset())  # gives the lazy layers their sizes
    frames = worlds * shepherds * steps
    for batch in Collector(env, actor, frames_per_batch=frames, total_frames=frames):
        reward = batch['next', 'reward']
        print(f'{tuple(batch.batch_size)}: mean return {float(reward.sum(dim=1).mean()):.3f}')


if __name__ == '__main__':
    tyro.cli(main)
