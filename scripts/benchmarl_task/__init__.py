"""Herding as a task of BenchMARL."""

from collections.abc import Callable
from functools import partial
from typing import Any

from benchmarl.environments.pettingzoo.common import PettingZooClass
from shepherd_ros.integrations.environments import HerdingParallelEnv
from shepherd_ros.sim.lidar import LidarConfig
from shepherd_ros.sim.observation import ObservationConfig
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import SpawnConfig, WorldConfig
from torchrl.envs import EnvBase, FlattenObservation, PettingZooWrapper, TransformedEnv


def near_goal(sheep: int, shepherds: int, rays: int, steps: int) -> EnvConfig:
    """Return an easy setting: the flock starts near the goal."""
    near = SpawnConfig(flock_distance_min=6.0, flock_distance_max=12.0)
    world = WorldConfig(sheep, shepherds, episode_steps=steps, goal_radius=5.0, spawn=near)
    observation = ObservationConfig(layout='ring', align='goal', unit=10.0, frame_interval=2.0)
    return EnvConfig(world=world, lidar=LidarConfig(rays), observation=observation)


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
