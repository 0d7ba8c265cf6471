#!/usr/bin/env python3
"""Training of a team with BenchMARL: its MAPPO, two shepherds, ten sheep near the goal."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
import sys
from typing import Any

from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import ObservationConfig
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import SpawnConfig, WorldConfig
import tyro

try:
    from benchmarl.algorithms import MappoConfig
    from benchmarl.environments.pettingzoo.common import PettingZooClass
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig
    from shepherd_ros.integrations.environments import HerdingParallelEnv
    from torchrl.envs import EnvBase, FlattenObservation, PettingZooWrapper, TransformedEnv
except ImportError as error:
    sys.exit(f"{error}; install it: pip install '.[envs]' benchmarl")


def flat_env(config: EnvConfig, seed: int | None, device: Any) -> EnvBase:
    """Return a world whose shepherds are the group `shepherd`, with flat observations."""
    env = PettingZooWrapper(HerdingParallelEnv(config), seed=seed, device=device)
    return TransformedEnv(env, FlattenObservation(-2, -1, in_keys=[('shepherd', 'observation')]))


class HerdingTask(PettingZooClass):
    """A herding task, whose configuration is {'env': EnvConfig}."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """Return what makes a world."""
        return partial(flat_env, self.config['env'], seed, device)

    def supports_continuous_actions(self) -> bool:
        """Return True: actions are velocities."""
        return True

    def has_render(self, env: EnvBase) -> bool:
        """Return False: shepherd bag render draws episodes."""
        return False

    def max_steps(self, env: EnvBase) -> int:
        """Return the steps of an episode."""
        return int(self.config['env'].world.episode_steps)


def main(out: str, samples: int = 100_000, sheep: int = 10, shepherds: int = 2, rays: int = 32,
         steps: int = 200, seed: int = 0) -> None:  # fmt: skip
    """Train; BenchMARL writes its logs into the folder OUT."""
    near = SpawnConfig(flock_distance_min=6.0, flock_distance_max=12.0)
    world = WorldConfig(sheep, shepherds, episode_steps=steps, goal_radius=5.0, spawn=near)
    seen = ObservationConfig(layout='ring', align='goal', unit=10.0, spacing=4)
    env = EnvConfig(world=world, lidar=LidarConfig(rays), observation=seen)
    Path(out).mkdir(parents=True, exist_ok=True)
    config = ExperimentConfig.get_from_yaml()
    config.save_folder, config.loggers = out, ['csv']
    config.evaluation = config.render = False
    config.max_n_frames, config.on_policy_n_envs_per_worker = samples, 2
    config.on_policy_collected_frames_per_batch = min(samples, 10 * steps)
    config.on_policy_minibatch_size = min(400, samples)
    model, task = MlpConfig.get_from_yaml(), HerdingTask('HERDING', {'env': env})
    Experiment(task, MappoConfig.get_from_yaml(), model, seed, config, model).run()


if __name__ == '__main__':
    tyro.cli(main)
