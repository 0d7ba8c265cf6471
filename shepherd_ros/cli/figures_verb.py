"""Verb figures: the paper's figures from rows of results, and a page of verdicts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TYPE_CHECKING

from shepherd_ros.cli.out_folders import claimed_folder
from shepherd_ros.cli.progress import progress
from shepherd_ros.cli.user_error import UserError
import tyro

if TYPE_CHECKING:
    from shepherd_ros.experiments.results import Results
    from shepherd_ros.experiments.samples import Samples


@dataclass
class Figures:
    """
    Draw the figures of the paper and of the sweeps beyond it, as PNG and SVG.

    In a sweep beyond the paper, only controllers that have all its settings are drawn.
    """

    rows: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Rows that shepherd evaluate wrote: Parquet files or folders of them."""
    out: Path = Path('out/figures')
    """Folder of the pictures."""
    curves: tuple[Path, ...] = ()
    """Training curves for figure 3: .jsonl files, runs, or folders of them."""
    checkpoints: tuple[str, ...] = ()
    """Checkpoints for figure 9; those of the policies in the rows if not given."""
    preset: str = ''
    """Preset that the rows were made with, instead of default."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """PATH=VALUE that the rows were made with (repeatable)."""
    report: bool = False
    """Also write README.md with a verdict on each statement of the paper, and summary.csv."""
    command: str = 'shepherd figures'
    """What the page says it was made by."""
    overwrite: bool = False
    """Write into a folder that holds something else."""

    def run(self) -> int:
        """Draw all; return the exit code."""
        from shepherd_ros.experiments.methods import checkpoint_of, full_name, loaded
        from shepherd_ros.experiments.results import read_results
        from shepherd_ros.experiments.value_map import value_map
        from shepherd_ros.paper.curves import find_curves
        from shepherd_ros.paper.drawing import save
        from shepherd_ros.paper.figures import draw, draw_curves, draw_values
        from shepherd_ros.paper.summary import draw_summary
        from shepherd_ros.paper.verdicts import has_critic
        import torch

        claimed_folder('--out', self.out, '*.svg', self.overwrite)
        torch.set_num_threads(1)
        if not self.rows:
            raise UserError('figures needs rows: expected files or folders of shepherd evaluate')
        rows, curves = read_results(self.rows), find_curves(self.curves)
        samples = self._samples(rows)
        known = [name for name in rows.distinct('controller') if name.startswith('policy:')]
        named = [full_name(f'policy:{checkpoint}') for checkpoint in self.checkpoints]
        critics = [name for name in dict.fromkeys(named or known) if has_critic(name)]
        pictures = {}
        with progress('drawing', len(samples)) as show:
            for done, (name, found) in enumerate(samples.items()):
                show(done, text=name)
                pictures[name] = draw(found)
        if (summary := draw_summary(samples.values())) is not None:
            pictures['summary'] = summary
        if curves:
            pictures['fig3'] = draw_curves(curves)
        if critics:
            maps = {name: value_map(loaded(checkpoint_of(name))) for name in critics}
            pictures['fig9'] = draw_values(maps)
        for name, figure in pictures.items():
            print(*save(figure, self.out, name))
        if self.report:
            from shepherd_ros.paper.verdicts import (
                verdicts_on_curves,
                verdicts_on_samples,
                verdicts_on_values,
            )

            outcomes = [
                *verdicts_on_curves(curves),
                *(j for found in samples.values() for j in verdicts_on_samples(found)),
                *verdicts_on_values(critics),
            ]
            self._report(outcomes, samples, list(pictures), rows)
        return 0

    def _samples(self, rows: Results) -> dict[str, Samples]:
        """Return the samples of each experiment in the rows; UserError without any."""
        from shepherd_ros.experiments.catalog import EXPERIMENTS, OF_THE_PAPER
        from shepherd_ros.experiments.samples import samples_of

        samples: dict[str, Samples] = {}
        for experiment in EXPERIMENTS.values():
            beyond = experiment.name not in OF_THE_PAPER
            chosen = experiment.with_preset(self.preset).with_changes(self.set)
            found = samples_of(rows, chosen, least=2, whole=beyond)
            if found is not None:
                samples[experiment.name] = found
                print(*found.notes, sep='\n', end='\n' if found.notes else '')
        if not samples:
            raise UserError('the rows are of no experiment: expected those of shepherd evaluate')
        return samples

    def _report(
        self, outcomes: list[Any], samples: dict[str, Samples], pictures: list[str], rows: Results
    ) -> None:
        """Write README.md, summary.csv and table.md."""
        from shepherd_ros.experiments.table import CSV_HEADER, csv_rows, grids
        from shepherd_ros.paper.report import page

        reasons = 'reasons.md' if (self.out / 'reasons.md').exists() else ''
        text = page(outcomes, samples, pictures, rows, self.command, reasons)
        (self.out / 'README.md').write_text(text, encoding='utf-8')
        lines = CSV_HEADER + ''.join(csv_rows(found) for found in samples.values())
        (self.out / 'summary.csv').write_text(lines, encoding='utf-8')
        if 'table' in samples:
            (self.out / 'table.md').write_text(grids(samples['table']), encoding='utf-8')
        print(self.out / 'README.md')
