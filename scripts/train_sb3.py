#!/usr/bin/env python3
"""Train with Stable-Baselines3's PPO: a shepherd, ten sheep that start near the goal, 128 rays."""

import sys

from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import ObservationConfig
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import SpawnConfig, WorldConfig
import torch
import tyro

try:
    from shepherd_ros.integrations.sb3 import evaluate, HerdingVecEnv, LidarFeatures
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
except ImportError as error:
    sys.exit(f"{error}; install it: pip install -c constraints.txt '.[sb3]'")


def main(out: str, samples: int = 300_000, sheep: int = 10, shepherds: int = 1, rays: int = 128,
         seed: int = 0, worlds: int = 64, steps: int = 200, hold: float = 4) -> None:  # fmt: skip
    """Train, save OUT.zip, and say how good the mean action is; an action is held for HOLD [s]."""
    torch.set_num_threads(1)
    near = SpawnConfig(flock_distance_min=6.0, flock_distance_max=12.0)
    world = WorldConfig(sheep, shepherds, episode_steps=steps, goal_radius=5.0, spawn=near)
    observation = ObservationConfig(layout='ring', align='goal', unit=10.0, frame_interval=hold)
    config = EnvConfig(world=world, lidar=LidarConfig(rays), observation=observation)
    env = VecNormalize(VecMonitor(HerdingVecEnv(config, worlds, hold)), norm_obs=False, gamma=0.96)
    model = PPO('MlpPolicy', env, 5e-4, n_steps=round(steps * world.dt / hold), batch_size=400,
                n_epochs=6, gamma=0.96, policy_kwargs={'features_extractor_class': LidarFeatures},
                seed=seed, device='cpu', verbose=1)  # fmt: skip
    before = evaluate(model, config, 64, hold, seed=10**6)
    model.learn(samples).save(out)
    print('before:', before, '\nafter: ', evaluate(model, config, 64, hold, seed=10**6))


if __name__ == '__main__':
    tyro.cli(main)
