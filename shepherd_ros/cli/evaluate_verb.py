"""Verb evaluate: experiments in batched simulation, one row of Parquet an episode."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, TYPE_CHECKING

from shepherd_ros.cli.code import commit
from shepherd_ros.cli.out_folders import claimed_folder
from shepherd_ros.cli.progress import progress
from shepherd_ros.cli.user_error import UserError
from shepherd_ros.experiments.setting_arguments import ManySettings
import tyro

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from shepherd_ros.experiments.campaign import CellTask
    from shepherd_ros.experiments.catalog import Experiment
    from shepherd_ros.experiments.setting import Setting


@dataclass(kw_only=True)
class Evaluate(ManySettings):
    """
    Run experiments: figures of the paper (4 to 8), fractions, table, and sweeps beyond the paper.

    Every controller gets the same starts. What is done already is not done again. Options of the
    world take several values, in the place of those of the experiment.
    """

    experiments: Annotated[tuple[str, ...], tyro.conf.Positional] = ('table',)
    """Names such as 4, fig5, fractions, table, herdability; or paper, beyond, all."""
    controllers: tuple[str, ...] = ()
    """Who drives, a policy as policy:CHECKPOINT; those of the experiment if not given."""
    policies: tuple[str, ...] = ()
    """Policies in the place of `policy` among the controllers, such as policy:CHECKPOINT."""
    primary: tuple[str, ...] = ()
    """Policies in the place of `policy`, too, each for the flock that it was trained with."""
    episodes: int | None = None
    """Episodes of each cell; 100 if not given, 20 for the large sweeps beyond the paper."""
    workers: int = 1
    """Processes that run at the same time."""
    shard: str = ''
    """
    Part i/n of the cells, for n machines; copy their folders together afterwards.

    Not needed where torchrun has started this: each of its processes then does its part.
    """
    quick: bool = False
    """Only where the statements of the paper look, 50 episodes of each cell."""
    stop_early: bool = False
    """End a figure of the paper once its verdicts are certain, after 50 episodes or more."""
    seed: int = 0
    """Seed of the first episode."""
    preset: str = ''
    """Named setting of time step and flock, instead of default."""
    out: Path = Path('out/rows')
    """Folder of the rows; <experiment>.md in it is a table of what it has."""
    overwrite: bool = False
    """Write into a folder that holds something else."""

    def run(self) -> int:
        """Run the missing cells; return the exit code."""
        from shepherd_ros.experiments.campaign import shard_of
        from shepherd_ros.experiments.catalog import experiments
        from shepherd_ros.learning.distributed import barrier, ranks

        if self.workers < 1:
            raise UserError(f'--workers is {self.workers}: expected at least 1')
        if self.stop_early and (self.shard or ranks() > 1):
            raise UserError('--stop-early needs all rows: expected no --shard, and one process')
        chosen = [self.changed(experiment) for experiment in experiments(self.experiments)]
        # a mistake is named before a folder is made
        shard_of(list(self.planned(chosen).values()), self.shard or '1/1')
        claimed_folder('--out', self.out, '*.md *.parquet */*.parquet */.*.part', self.overwrite)
        for part in self.rounds(chosen):
            self.run_missing(list(self.planned(part).values()))
        barrier()
        self.write_tables(chosen)
        return 0

    def planned(self, chosen: Sequence[Experiment]) -> dict[tuple[str, int], CellTask]:
        """Return the cells of experiments, each once."""
        from shepherd_ros.experiments.campaign import plan

        return {
            (task.key, task.cell.first): task
            for e in chosen
            for task in plan(e.settings, e.controllers, self.seed, e.episodes)
        }

    def rounds(self, chosen: list[Experiment]) -> Iterator[list[Experiment]]:
        """Yield what to run, one part after another; with --stop-early, less after each."""
        from shepherd_ros.experiments.results import results_in
        from shepherd_ros.experiments.samples import samples_of
        from shepherd_ros.paper.primary import primary_policies
        from shepherd_ros.paper.stopping import is_certain, ROUND

        if not self.stop_early:
            yield chosen
            return
        most, going = max(e.episodes for e in chosen), list(chosen)
        primary = primary_policies(self.preset, self.primary)
        minutes = sum(task.cell.cost() for task in self.planned(chosen).values()) / 60
        print(f'all episodes would be about {minutes:.0f} minutes of one core')
        for count in (*range(ROUND, most, ROUND), most):
            yield [replace(e, episodes=min(e.episodes, count)) for e in going]
            rows, still = results_in(self.out), []
            for experiment in going:
                samples = samples_of(rows, experiment)
                assert samples is not None, 'it was run'
                flock = samples.settings[0].flock
                if experiment.episodes > count and not is_certain(samples, primary[flock]):
                    still.append(experiment)
                elif experiment.episodes > count:
                    print(f'{experiment.name}: all verdicts are certain after {count} episodes')
            going = still
            if not going:
                return

    def run_missing(self, tasks: list[CellTask]) -> None:
        """Run the cells whose rows are not there, or this process's part of them."""
        from shepherd_ros.experiments.campaign import codes_of, done_of, run_tasks, shard_of
        from shepherd_ros.experiments.cells import Cell
        from shepherd_ros.experiments.results import results_in
        from shepherd_ros.learning.distributed import barrier, rank, ranks

        own_tasks = shard_of(tasks, self.shard or f'{rank() + 1}/{ranks()}')
        rows = results_in(self.out)
        barrier()  # a file that is read is not replaced meanwhile
        finished = done_of(own_tasks, rows)
        missing = [task for task in own_tasks if task not in finished]
        code, ended = commit(), 0
        spent, total = 0.0, sum(task.cell.cost() for task in missing)
        with progress('cells', total, quiet=rank() > 0) as show:
            _tell(own_tasks, missing, code, codes_of(finished, rows), self.workers)
            _tell_timings(own_tasks)

            def done(cell: Cell) -> None:
                nonlocal ended, spent
                ended, spent = ended + 1, spent + cell.cost()
                show(spent, text=f'{ended} of {len(missing)}')

            run_tasks(self.out, missing, self.workers, code, done)

    def changed(self, experiment: Experiment) -> Experiment:
        """Return an experiment with the changes that were asked for."""
        from shepherd_ros.experiments.catalog import QUICK_EPISODES

        experiment = experiment.with_preset(self.preset).with_changes(self.worlds.set)
        experiment = experiment.in_tasks(self.worlds.task)
        settings = experiment.quick if self.quick else experiment.settings
        for f in fields(self.worlds):
            if f.name not in ('set', 'task'):
                settings = _with_values(settings, f.name, getattr(self.worlds, f.name))
        episodes = QUICK_EPISODES if self.quick else experiment.episodes
        policies = (*self.primary_of(settings), *self.policies)
        return replace(
            experiment,
            settings=settings,
            controllers=_with_policies(self.controllers or experiment.controllers, policies),
            episodes=episodes if self.episodes is None else self.episodes,
        )

    def primary_of(self, settings: Sequence[Setting]) -> tuple[str, ...]:
        """Return the primary policies for the flocks of settings, () without --primary."""
        from shepherd_ros.paper.primary import primary_policies

        if not self.primary:
            return ()
        chosen = primary_policies(self.preset, self.primary)
        return tuple(dict.fromkeys(chosen[s.flock] for s in settings if s.flock in chosen))

    def write_tables(self, chosen: list[Experiment]) -> None:
        """Write a table of each experiment beside the rows, once all are there; say where."""
        from shepherd_ros.experiments.campaign import done_of
        from shepherd_ros.experiments.criteria import criteria_page
        from shepherd_ros.experiments.results import results_in
        from shepherd_ros.experiments.samples import samples_of
        from shepherd_ros.experiments.table import markdown
        from shepherd_ros.learning.distributed import rank

        if rank() > 0:
            return
        rows, tasks = results_in(self.out), self.planned(chosen)
        if not self.stop_early and len(done_of(tasks.values(), rows)) < len(tasks):
            return
        for experiment in chosen:
            samples = samples_of(rows, experiment)
            if samples is not None:
                path = self.out / f'{experiment.name}.md'
                page = criteria_page if experiment.name == 'cells' else markdown
                path.write_text(page(samples), encoding='utf-8')
                print(path, *samples.notes, sep='\n')


def _tell(
    tasks: list[CellTask], missing: list[CellTask], code: str, codes: Sequence[str], workers: int
) -> None:
    """Print the number of missing cells, and the commits that wrote the others."""
    minutes = sum(task.cell.cost() for task in missing) / 60
    print(
        f'{sum(t.cell.count for t in tasks)} episodes in {len(tasks)} cells, '
        f'{len(tasks) - len(missing)} of them done; about {minutes:.0f} minutes of one '
        f'core are left, {minutes / workers:.0f} with {workers} on cores of their own'
    )
    others = [name or 'unknown' for name in codes if name != code]
    if others:
        print(
            f'done by other code: {", ".join(others)}; this is {code or "unknown"}, give another '
            '--out to measure with it'
        )


def _tell_timings(tasks: list[CellTask]) -> None:
    """Print a note on each policy whose intervals are no multiples of the time step."""
    from shepherd_ros.experiments.methods import timing_note
    from shepherd_ros.experiments.setting import env_config

    pairs = {(t.cell.controller, env_config(t.cell.setting).world.dt): None for t in tasks}
    for note in filter(None, (timing_note(name, dt) for name, dt in pairs)):
        print(note)


def _with_values(
    settings: tuple[Setting, ...], name: str, values: tuple[Any, ...]
) -> tuple[Setting, ...]:
    """Return the settings with other values of a field, each once."""
    if not values:
        return settings
    changed = (replace(s, **{name: value}) for value in values for s in settings)
    return tuple(dict.fromkeys(changed))


def _with_policies(names: tuple[str, ...], policies: tuple[str, ...]) -> tuple[str, ...]:
    """Return controllers with others in the place of `policy`."""
    if 'policy' not in names or not policies:
        return names
    return (*policies, *(name for name in names if name != 'policy'))
