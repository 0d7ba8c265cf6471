#!/usr/bin/env python3
"""Training of a team with BenchMARL: its MAPPO, two shepherds, ten sheep near the goal."""

from pathlib import Path
import sys

import tyro

try:
    from benchmarl.algorithms import MappoConfig
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig
    from benchmarl_task import HerdingTask, near_goal
except ImportError as error:
    sys.exit(f"{error}; install it: pip install '.[envs]' benchmarl")


def main(out: str, samples: int = 100_000, sheep: int = 10, shepherds: int = 2, rays: int = 32,
         steps: int = 200, seed: int = 0) -> None:  # fmt: skip
    """Train; BenchMARL writes its logs into the folder OUT."""
    Path(out).mkdir(parents=True, exist_ok=True)
    config = ExperimentConfig.get_from_yaml()
    config.save_folder, config.loggers = out, ['csv']
    config.evaluation = config.render = False
    config.max_n_frames, config.on_policy_n_envs_per_worker = samples, 2
    config.on_policy_collected_frames_per_batch = min(samples, 10 * steps)
    config.on_policy_minibatch_size = min(400, samples)
    model, env = MlpConfig.get_from_yaml(), near_goal(sheep, shepherds, rays, steps)
    task = HerdingTask('HERDING', {'env': env})
    Experiment(task, MappoConfig.get_from_yaml(), model, seed, config, model).run()


if __name__ == '__main__':
    tyro.cli(main)
