"""Task of a training: the distribution of the worlds of its episodes."""

from __future__ import annotations

from dataclasses import dataclass, replace
import random
from typing import ClassVar

from shepherd_ros.config import ConfigError, option, part
from shepherd_ros.registry import Extended
from shepherd_ros.sim.flocking import FLOCK_MODELS, PAPER_FLOCKS
from shepherd_ros.sim.goal_motion import GOAL_PATHS
from shepherd_ros.sim.presets import home_world, training_world, world_preset
from shepherd_ros.sim.reward import RewardConfig
from shepherd_ros.sim.rng import Stream, uniform
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.tasks import TASKS
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.sim.world_parameters import WORLD_PARAMETERS
import torch
from torch import Tensor


@dataclass(frozen=True)
class TaskConfig(Extended):
    """
    Distribution of episodes and their reward; the defaults are the paper's training.

    Everything is drawn evenly, but for sheep on a logarithmic scale. Parameters of the world that
    plug-ins add are the same in all episodes.
    """

    registry: ClassVar = WORLD_PARAMETERS
    task: str = option('herding', 'what the team has to do', choices=lambda: tuple(TASKS))
    preset: str = option('default', 'named setting of time step and flock')
    flock: str = option(
        'strombom',
        'model, or both of the paper',
        choices=lambda: (*FLOCK_MODELS, 'both'),
    )
    sheep_min: int = option(100, 'fewest sheep', low=1, high=10_000)
    sheep_max: int = option(100, 'most sheep', low=1, high=10_000)
    sheep_scale: str = option(
        'linear',
        'each size (linear) or doubling (log) as often',
        choices=('linear', 'log'),
    )
    shepherds_min: int = option(1, 'fewest shepherds', low=1, high=100)
    shepherds_max: int = option(6, 'most shepherds', low=1, high=100)
    goal_radius_min: float = option(4.0, 'smallest goal [m]', low=0.01)
    goal_radius_max: float = option(8.0, 'largest goal [m]', low=0.01)
    repulsion_min: float = option(2.0, 'least rho_a of a flock that has one', low=0.0)
    repulsion_max: float = option(2.0, 'greatest rho_a of a flock that has one', low=0.0)
    noise_max: float = option(0.0, 'highest noise on perceived positions [m]', low=0)
    noise_free_share: float = option(
        0.0, 'share of episodes without that noise', low=0.0, high=1.0
    )
    goal_speed_max: float = option(0.0, 'highest speed of a goal [m/s]; 0: unchanged', low=0.0)
    goal_still_share: float = option(0.5, 'share of those goals that stand', low=0.0, high=1.0)
    team_exponent: float = option(
        0.0,
        'a team of M is drawn by M to minus this',
        low=0.0,
    )
    home_share: float = option(
        0.0,
        'share of episodes that start at the goal',
        low=0.0,
        high=1.0,
    )
    home_distance_min: float = option(0.0, 'their flock, nearest to the goal [m]', low=0.0)
    home_distance_max: float = option(2.0, 'their flock, farthest from the goal [m]', low=0.0)
    effort: float = option(
        0.0, 'reward that a meter of its way costs a shepherd (choice: the paper has none)', low=0
    )
    effort_from: str = option(
        'start',
        'always, or when home',
        choices=('start', 'home'),
    )
    reward: RewardConfig = part(RewardConfig)
    episode_steps: int = option(400, 'steps after which a training episode is cut', low=1)

    def __post_init__(self) -> None:
        """Check each field and the order of the intervals."""
        super().__post_init__()
        for name in ('sheep', 'shepherds', 'goal_radius', 'repulsion', 'home_distance'):
            low, high = getattr(self, f'{name}_min'), getattr(self, f'{name}_max')
            if low > high:
                raise ConfigError(f'{name}_min is {low}: expected at most {name}_max, {high}')
        world_preset(self.preset)

    @property
    def dt(self) -> float:
        """Return the time step of the worlds [s]."""
        return world_preset(self.preset).dt

    @property
    def flocks(self) -> tuple[str, ...]:
        """Return the flock models that are trained on."""
        return PAPER_FLOCKS if self.flock == 'both' else (self.flock,)


def task_defaults(config: TaskConfig, task: str) -> TaskConfig:
    """Return the distribution with the defaults of another task."""
    kind = TASKS[task]
    return replace(config, task=task, **{'flock': kind.flock, **kind.training})


def draw_environment(task: TaskConfig, seed: int) -> EnvConfig:
    """Return the environment of one episode, the same for the same seed."""
    draw = random.Random(seed)
    # every number is drawn whether it is used or not, so that options do not shift each other
    flock = draw.choice(PAPER_FLOCKS)
    sheep = draw.randint(task.sheep_min, task.sheep_max)
    repulsion = draw.uniform(task.repulsion_min, task.repulsion_max)
    noise = draw.uniform(0.0, task.noise_max)
    at_home = draw.random() < task.home_share
    share = draw.random()
    if task.sheep_scale == 'log':
        ratio = (task.sheep_max + 1) / task.sheep_min
        sheep = min(int(task.sheep_min * ratio**share), task.sheep_max)
    noise = 0.0 if draw.random() < task.noise_free_share else noise
    still, speed = draw.random() < task.goal_still_share, draw.uniform(0.0, task.goal_speed_max)
    path = draw.choice(GOAL_PATHS)
    base = base_world(task, flock if task.flock == 'both' else task.flock)
    base = near_home(base, task) if at_home else base
    weight = base.flock.repulsion_option
    flock_config = replace(base.flock, **({weight: repulsion} if weight else {}))
    world = replace(base, n_sheep=sheep, flock=flock_config)
    if task.goal_speed_max:
        world = replace(world, goal_speed=0.0 if still else speed, goal_path=path)
    return EnvConfig(noise_std=noise, world=world, reward=task.reward)


def near_home(world: WorldConfig, task: TaskConfig) -> WorldConfig:
    """Return a world that starts with the flock at home, as far from the goal as a task says."""
    world = home_world(world)
    spawn = replace(
        world.spawn,
        flock_distance_min=task.home_distance_min,
        flock_distance_max=task.home_distance_max,
    )
    return replace(world, spawn=spawn)


def start_of(task: TaskConfig, world: WorldConfig, seed: Tensor) -> WorldState:
    """Return the first state of episodes with these seeds, (...) int64, in a world of a task."""
    if not task.team_exponent:
        return spawn(world, seed)
    whole = replace(world, spawn=replace(world.spawn, fewest_shepherds=0))
    state, teams = spawn(whole, seed), torch.arange(task.shepherds_min, task.shepherds_max + 1)
    share = (teams.double() ** -task.team_exponent).cumsum(dim=0)
    zero, index = torch.zeros_like(seed), torch.zeros(1, dtype=torch.int64, device=seed.device)
    drawn = uniform(seed, zero, Stream.N_SHEPHERDS, index, torch.float64)  # (..., 1)
    passed = drawn * share[-1] >= share[:-1].to(seed.device)
    size = task.shepherds_min + passed.sum(dim=-1, keepdim=True)  # (..., 1)
    present = torch.arange(task.shepherds_max, device=seed.device) < size
    shepherds = torch.where(present[..., None], state.shepherds, state.goal[..., None, :])
    return replace(state, shepherds=shepherds, shepherd_mask=present)


def base_world(task: TaskConfig, flock: str) -> WorldConfig:
    """Return the world of a flock model with the starts of training."""
    world = training_world(world_preset(task.preset, flock, task.task))
    spawn = replace(
        world.spawn,
        fewest_shepherds=task.shepherds_min,
        goal_radius_extra=task.goal_radius_max - task.goal_radius_min,
    )
    return replace(
        world,
        n_shepherds=task.shepherds_max,
        goal_radius=task.goal_radius_min,
        spawn=spawn,
        others=task.others,
    )
