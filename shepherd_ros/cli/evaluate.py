"""Verb evaluate: controllers on many episodes in batched simulation, as a table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
import sys

from rich.progress import Progress, TimeElapsedColumn, TimeRemainingColumn
from shepherd_ros.cli import UserError


@dataclass
class Evaluate:
    """Run every controller on the same starts and write a table of the paper's metrics."""

    controllers: tuple[str, ...] = ('strombom', 'pierson')
    """Controllers to compare."""
    shepherds: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    """Team sizes."""
    sheep: tuple[int, ...] = (100,)
    """Flock sizes."""
    flock: str = 'strombom'
    """Flock model."""
    preset: str = 'default'
    """Named setting of time step and flock."""
    episodes: int = 100
    """Episodes per row, with seeds seed, seed + 1, ..."""
    seed: int = 0
    """Seed of the first episode."""
    steps: int = 1000
    """Steps of an episode."""
    noise: float = 0.0
    """Standard deviation of the noise on perceived positions [m]."""
    threads: int = 1
    """Threads of torch."""
    out: Path | None = None
    """Markdown file to write; the screen if not given."""

    def run(self) -> int:
        """Run all; return the exit code."""
        from shepherd_ros.controllers import make_controller
        from shepherd_ros.evaluation.runner import mean_and_interval, run_episodes
        from shepherd_ros.sim.env import EnvConfig
        from shepherd_ros.sim.metrics import PAPER_METRICS
        from shepherd_ros.sim.presets import world_preset
        import torch

        if self.episodes < 1:
            raise UserError(f'--episodes is {self.episodes}: expected at least 1')
        torch.set_num_threads(self.threads)
        base = replace(world_preset(self.preset, self.flock), episode_steps=self.steps)
        cells = [
            (n, m, name) for n in self.sheep for m in self.shepherds for name in self.controllers
        ]
        worlds = {
            (n, m): replace(base, n_sheep=n, n_shepherds=m)
            for n in self.sheep
            for m in self.shepherds
        }
        controllers = {(n, m, name): make_controller(name, worlds[n, m]) for n, m, name in cells}
        columns = (*PAPER_METRICS, 'fraction_in_goal', 'shepherd_path_to_completion')
        lines = [
            '| sheep | shepherds | controller | ' + ' | '.join(columns) + ' |',
            '|--:|--:|:--|' + '--:|' * len(columns),
        ]
        columns_shown = [*Progress.get_default_columns()[:2], TimeElapsedColumn()]
        with Progress(*columns_shown, TimeRemainingColumn(), transient=True) as progress:
            task = progress.add_task('episodes', total=len(cells) * self.steps)
            for n, m, name in cells:
                progress.update(task, description=f'{name}, {n} sheep, {m} shepherds')
                config = EnvConfig(world=worlds[n, m], noise_std=self.noise)
                result = run_episodes(
                    config,
                    controllers[n, m, name],
                    self.seed,
                    self.episodes,
                    lambda step: progress.advance(task),
                )
                pairs = [mean_and_interval(result[column]) for column in columns]
                values = ' | '.join(f'{mean:.3g} ± {half:.2g}' for mean, half in pairs)
                lines.append(f'| {n} | {m} | {name} | {values} |')
        text = '\n'.join(lines) + '\n'
        if self.out is None:
            sys.stdout.write(text)
        else:
            self.out.parent.mkdir(parents=True, exist_ok=True)
            self.out.write_text(text, encoding='utf-8')
        return 0
